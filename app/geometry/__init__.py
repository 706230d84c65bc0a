"""Poses, cameras and the papers' equations on NumPy. `README.md` maps each equation to its function."""
