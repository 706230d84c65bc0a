"""The pages, measured in a real browser on the demonstration venue."""
