"""Kills at random moments: nothing acknowledged is lost, each build is done once, and it serves.

`FAULTS` in the environment is the number of kills; `make faults` sets a large one. Every moment comes from a seed.
"""

from __future__ import annotations

import json
import os
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

from bench.kills.clients import Sent
from bench.kills.run import Site, run_kills
from bench.postgres import is_installed, postgres
from tests.scenes import CAMERA_TEXT, View, scan_files, zipped

KILLS = int(os.environ.get("FAULTS", "3"))
WITHOUT_POSTGRES = pytest.mark.skipif(not is_installed(), reason="no PostgreSQL here")


@pytest.mark.timeout(0)
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
@pytest.mark.parametrize(
    "servers", [1, pytest.param(2, marks=WITHOUT_POSTGRES)], ids=["sqlite", "postgresql"]
)
def test_kills_at_random_lose_nothing(tmp_path: Path, views: list[View], servers: int) -> None:
    sent = Sent(
        scan=zipped(scan_files(views[:4])),
        options=json.dumps({"camera": CAMERA_TEXT}),
        picture=views[2].jpeg(),
        camera=CAMERA_TEXT,
    )
    with nullcontext() if servers == 1 else postgres() as url:
        site = Site(data_dir=tmp_path / "data", logs=tmp_path, servers=servers, database_url=url)
        outcome = run_kills(site, sent, 0, lambda number: number >= KILLS)
    assert outcome.wrong == []
    assert outcome.kills.total() == KILLS
    assert outcome.starts == outcome.kills["server"]
    assert outcome.builds.total() == len(outcome.kept.builds) >= 1
    assert outcome.place.position is not None
    assert np.linalg.norm(outcome.place.position - views[2].world_from_camera.translation) < 0.05
