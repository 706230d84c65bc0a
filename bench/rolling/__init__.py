"""Two servers that are replaced one after the other while they are used."""
