"""Endpoints that take a scan and build nothing."""
