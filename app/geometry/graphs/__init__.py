"""Many poses at once."""
