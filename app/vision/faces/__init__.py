"""Faces in pictures that are kept."""
