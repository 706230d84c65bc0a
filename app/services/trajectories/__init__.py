"""Where sessions went."""
