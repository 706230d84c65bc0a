"""What of a map can be drawn: its points, where it locates a camera, and how it looks from above."""
