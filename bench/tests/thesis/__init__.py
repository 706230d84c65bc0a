"""The thesis's experiments."""
