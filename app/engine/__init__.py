"""What locates a camera: everything that knows no database, settings or HTTP. Rooms, from the ground up: floors, maps,
query, then mapping and anchors, then tracking; navigation stands on floors alone."""
