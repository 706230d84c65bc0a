"""Tests of app/engine/query/vdm."""
