"""Maps of many keyframes, tiled from a real one, and what they cost."""
