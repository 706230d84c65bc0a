"""Pages of measured figures: docs/figures, each section written by the command that measured it."""
