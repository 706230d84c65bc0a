"""Builds that several workers make together, and how much faster they are."""
