"""How well monitoring cameras tell where a phone is."""
