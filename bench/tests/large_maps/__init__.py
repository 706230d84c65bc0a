"""Tests of tiled maps."""
