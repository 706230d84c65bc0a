"""Drift that is added to a scan, and what loop closure leaves of it."""
