"""Robust estimators of poses: one interface, by PoseLib or by OpenCV."""
