"""What the protocols of the Open Spatial Computing Platform need."""
