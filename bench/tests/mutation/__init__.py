"""Tests of bench/mutation."""
