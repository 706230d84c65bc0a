"""A scan that is built in a moment, and workers on both databases."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from bench.postgres import postgres
from tests.jobs.test_leases import WITHOUT_POSTGRES, Workers, site
from tests.scenes import View, scan_files, zipped


@pytest.fixture(scope="module")
def scan(views: list[View]) -> bytes:
    """A scan that is built in a moment."""
    return zipped(scan_files(views[:4]))


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=WITHOUT_POSTGRES)])
def workers(request: pytest.FixtureRequest, tmp_path: Path, scan: bytes) -> Iterator[Workers]:
    """Workers on SQLite, and on PostgreSQL."""
    if request.param == "sqlite":
        with site(tmp_path, scan, None) as found:
            yield found
    else:
        with postgres() as url, site(tmp_path, scan, url) as found:
            yield found
