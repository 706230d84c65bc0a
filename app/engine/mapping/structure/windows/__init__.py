"""Stretches of a video, each reconstructed at once from the motions between its pictures."""
