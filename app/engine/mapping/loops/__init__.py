"""Loops of a scan: places that it passes more than once, and the drift that they show."""
