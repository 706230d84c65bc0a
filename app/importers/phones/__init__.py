"""Scans of phones' apps, one module an app."""
