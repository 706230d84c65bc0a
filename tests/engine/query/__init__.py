"""Tests of app/engine/query."""
