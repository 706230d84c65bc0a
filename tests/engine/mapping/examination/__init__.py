"""Tests of app/engine/mapping."""
