"""Tests of poses estimated from pictures."""
