"""What was sent and can't be read: what it is, what it lacks, and how to export it rightly."""
