"""Unpacking uploaded archives that nobody vouches for: zip and tar."""
