"""Tests of app/services/trajectories."""
