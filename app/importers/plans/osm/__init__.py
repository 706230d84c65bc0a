"""OpenStreetMap's Simple Indoor Tagging, as GeoJSON or OSM XML."""
