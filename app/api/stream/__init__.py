"""The messages of a session's stream and their description."""
