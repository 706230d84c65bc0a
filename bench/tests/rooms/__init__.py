"""Tests of bench/rooms."""
