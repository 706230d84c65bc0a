"""How many machines many buildings and phones need, by what one query, one frame and one keyframe cost."""
