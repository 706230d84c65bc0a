"""One venue as a file: written from a server, and read into another one."""
