"""Walkers in the demonstration venue who follow guidance (C 6)."""
