"""Tracking of a moving camera: fixes by a map or an anchor, visual odometry between them (C 5.1)."""
