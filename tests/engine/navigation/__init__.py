"""Tests of app/engine/navigation."""
