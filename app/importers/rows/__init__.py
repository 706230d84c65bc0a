"""The rows of a scan's lists: which columns they have, and the poses, times and names in them."""
