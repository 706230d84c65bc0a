"""Tests of app/engine/maps."""
