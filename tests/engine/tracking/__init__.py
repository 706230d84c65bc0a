"""Tests of app/engine/tracking."""
