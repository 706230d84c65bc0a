"""One answer from several frames: a burst, or the cameras of a rig."""
