"""Tests of app/evaluation and its commands."""
