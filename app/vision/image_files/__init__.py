"""Image files as cameras and tools write them: which formats are read, and how a file says that it is turned."""
