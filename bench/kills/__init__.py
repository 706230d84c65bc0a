"""Servers and workers that are killed at random moments."""
