"""The connected parts of a video's path, joined where one part's pictures see points of another."""
