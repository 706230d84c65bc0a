"""The Visual-Depth Map paper's localization (B 2.3)."""
