"""The second look at a frame: matches by a network, and whether the whole picture agrees with a pose."""
