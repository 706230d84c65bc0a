"""Tests of bench/bare_rooms."""
