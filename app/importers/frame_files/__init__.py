"""What tools write for each frame of a scan: its camera, its pose, a JSON file."""
