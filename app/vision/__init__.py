"""Images to descriptors, matches and keyframes."""
