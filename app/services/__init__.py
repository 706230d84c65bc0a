"""What Roomfix does, called alike by the HTTP endpoints, the command line and the jobs."""
