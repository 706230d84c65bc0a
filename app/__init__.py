"""Roomfix: tells a camera where it is inside a building."""
