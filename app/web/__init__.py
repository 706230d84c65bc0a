"""The pages people open; they use only the public API."""
