"""Builds: from a row in the database to a published map version."""
