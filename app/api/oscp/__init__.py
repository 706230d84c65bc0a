"""The GeoPose protocol of the Open Spatial Computing Platform."""
