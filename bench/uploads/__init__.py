"""Uploads over connections that break."""
