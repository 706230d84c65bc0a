"""Floor plans as people have them (PDF, SVG, DXF, TIFF, large pictures), drawn as PNG in a process of their own."""
