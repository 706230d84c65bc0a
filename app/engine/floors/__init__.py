"""A floor, its plan, and what the plan means: landmarks, points of interest, areas and walkable links."""
