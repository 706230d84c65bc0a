"""A venue as a file, over HTTP."""
