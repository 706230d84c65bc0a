"""Visual odometry: points that are followed, keyframes that are adjusted together (C 5.1)."""
