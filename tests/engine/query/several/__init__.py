"""Tests of app/engine/query/several."""
