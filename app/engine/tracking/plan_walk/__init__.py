"""Following a camera on floor plans alone: odometry, rare fixes, and walls that nobody walks through."""
