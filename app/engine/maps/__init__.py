"""An open map: its artefact, its index, its surroundings, and what in it looks like something elsewhere."""
