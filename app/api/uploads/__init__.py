"""Uploads that survive broken connections."""
