"""Tests of app/services/builds."""
