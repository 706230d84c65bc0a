"""Tests of bench/evaluation and its reports."""
