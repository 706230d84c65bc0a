"""What pages draw of a map version."""
