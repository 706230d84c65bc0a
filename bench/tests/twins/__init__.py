"""Tests of bench/twins."""
