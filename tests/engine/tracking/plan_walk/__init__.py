"""Tests of following a camera on floor plans."""
