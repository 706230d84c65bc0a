"""Tests of the picture of all axes."""
