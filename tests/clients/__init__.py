"""The clients in `clients/`, against a real server."""
