"""The images of a scan: colour by its header, depth in every format that it is written in."""
