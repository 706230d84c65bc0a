"""What a floor plan means: landmarks, points of interest, areas and walkable links, from GeoJSON."""
