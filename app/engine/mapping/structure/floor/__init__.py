"""The floor that a walk leads over, as a tie of its scale and attitude."""
