"""Recorded scans tracked as a video."""
