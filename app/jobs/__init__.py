"""Long work outside the server's process."""
