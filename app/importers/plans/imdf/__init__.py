"""The Indoor Mapping Data Format 1.0 (Apple; OGC 20-094): a zip of GeoJSON files by feature type."""
