"""Geometry by its properties, on seeded synthetic scenes."""
