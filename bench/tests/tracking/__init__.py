"""Tracking beside the truth and beside other programs."""
