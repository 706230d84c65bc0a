"""How accurate and how fast: figures on any dataset."""
