"""Uploads that are looked at and not built."""
