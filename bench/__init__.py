"""What measures Roomfix, and the rendered building that it is tried in. Not in the wheel."""
