"""One cube seen by a camera, in the axes of each AR framework."""
