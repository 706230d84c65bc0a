"""Fixtures that the tests of the product and of the bench share."""

from __future__ import annotations

pytest_plugins = ["tests.fixtures"]
