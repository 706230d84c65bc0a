"""How requests are read: their bodies, their forms, and the names that they may hold."""
