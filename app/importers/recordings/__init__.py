"""Recordings that hold all frames of a scan in one file."""
