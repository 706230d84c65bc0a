"""The server as a process: its connections, and how it stops."""
