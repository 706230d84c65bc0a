"""Positioning by monitoring cameras (C 4)."""
