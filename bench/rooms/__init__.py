"""Real rooms: several ways of localization on every room and split, and what is fitted to them."""
