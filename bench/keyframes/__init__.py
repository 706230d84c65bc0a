"""Keyframe rules compared (B section 3)."""
