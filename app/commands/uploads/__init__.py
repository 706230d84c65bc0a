"""Sending a scan to a server over a connection that may break."""
