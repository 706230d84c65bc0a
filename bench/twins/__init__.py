"""Floors that look alike: one of them in a map of the other one, in buildings that decided no limit."""
