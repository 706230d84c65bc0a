"""Several cameras that move together: a rig, or the frames of a burst with known motion."""
