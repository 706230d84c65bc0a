"""One picture located in one map: matches, pose, verification, accuracy."""
