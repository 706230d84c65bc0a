"""Scans, phone pictures and monitoring frames of the demonstration venue, and the walks that make them."""
