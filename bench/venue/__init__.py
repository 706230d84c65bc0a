"""The demonstration building as data: rooms, furniture, decoration, plans."""
