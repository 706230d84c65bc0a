"""Routes over the walkable links of a venue's floors, and what to say to who follows one."""
