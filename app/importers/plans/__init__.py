"""Indoor maps of other programs: one module or folder a format, and what they share."""
