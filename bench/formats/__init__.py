"""A scan written in every format that is read, to show that each becomes the same map."""
