"""Scans as clients send them."""
