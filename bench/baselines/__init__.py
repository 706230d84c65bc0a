"""What Roomfix is compared with."""
