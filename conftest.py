"""Fixtures that the tests of the product and of the bench share, and the order in which files are run."""

from __future__ import annotations

import os
import re
from collections import Counter
from pathlib import Path

import pytest

pytest_plugins = ["tests.fixtures"]
SLOW_TESTS = Path(__file__).parent / "docs" / "figures" / "slow-tests.md"
ROW = re.compile(r"^\| `([^:`]+)::.*` \| ([\d.]+) \|", re.MULTILINE)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Return one process more than cores: tests that wait for servers and browsers leave theirs idle."""
    return 1 + (os.cpu_count() or 1)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run the files first whose slow tests took longest when they were measured last.

    Files are shared out to processes in this order: a long one at the end would leave the other processes idle.
    """
    seconds: Counter[str] = Counter()
    if SLOW_TESTS.exists():
        for path, taken in ROW.findall(SLOW_TESTS.read_text(encoding="utf-8")):
            seconds[path] += float(taken)
    items.sort(key=lambda item: -seconds[item.nodeid.partition("::")[0]])
