"""Tests of the demonstration venue and its renderer."""
