"""Fixtures that the tests of the product and of the bench share, the order in which files are run, and what makes all
of their processes start sooner."""

from __future__ import annotations

import gc
import os
import re
import sys
from collections import Counter
from pathlib import Path

import pytest

pytest_plugins = ["tests.fixtures"]
SLOW_TESTS = Path(__file__).parent / "docs" / "figures" / "slow-tests.md"
ROW = re.compile(r"^\| `([^:`]+)::.*` \| ([\d.]+) \|", re.MULTILINE)

# Tests start hundreds of processes: all but the first read the bytecode that this one wrote, whatever the environment
# says of writing it. The processes that share the tests read each other's rewritten assertions the same way.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
# What is imported and collected stays until the end; searching it for garbage takes an eighth of that time.
gc.disable()


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


def pytest_collection_finish() -> None:
    """Leave what was collected out of the searches for garbage, which go on now."""
    gc.freeze()
    gc.enable()
