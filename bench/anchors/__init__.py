"""How well monitoring cameras locate a phone."""
