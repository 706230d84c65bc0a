"""What depth images say of a path that was reconstructed from colour."""
