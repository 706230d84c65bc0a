"""The parts of an answer to a query: its place, its frames, and what the map says."""
