"""Structure from motion: camera poses estimated from the pictures of a video, of photos, or of a scan without poses."""
