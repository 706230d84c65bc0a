"""Everyday mistakes made on a right scan, and whether its examination names them."""
