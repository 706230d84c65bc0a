"""Tests of app/engine/floors."""
