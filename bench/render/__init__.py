"""The renderer: rectangles with textures, baked light, a camera and a depth sensor."""
