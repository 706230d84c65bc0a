"""Scan formats: each importer turns a folder of files into one `Scan` with one set of conventions."""
