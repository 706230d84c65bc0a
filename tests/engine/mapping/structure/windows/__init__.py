"""Tests of app/engine/mapping/structure/windows."""
