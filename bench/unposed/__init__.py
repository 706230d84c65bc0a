"""Maps of pictures without poses, as a video, photos and depth frames, against the poses that the scan has."""
