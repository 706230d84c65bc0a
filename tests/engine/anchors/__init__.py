"""Tests of app/engine/anchors."""
