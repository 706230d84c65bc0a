"""The monitoring-camera thesis's experiments in the rendered building (C chapter 6)."""
