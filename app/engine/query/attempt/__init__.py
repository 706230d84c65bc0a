"""One attempt to localize a picture by its matches: the pose, its rival, and the verdict on it."""
