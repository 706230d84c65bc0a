"""Scans that phones film in the browser."""
