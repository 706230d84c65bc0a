"""Bytes that change on disk, anywhere: never a wrong pose, never an answer that nobody expected.

`FAULTS` in the environment is the number of rounds; `make faults` sets a large one.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import httpx
import numpy as np
import pytest

from tests.scenes import CAMERA_TEXT, View, scan_files, zipped
from tests.server import QUICK, pose_errors, running

VENUE = "v"
ROUNDS = int(os.environ.get("FAULTS", "6"))
CLEAR = {"map_damaged", "database_damaged", "storage_failed"}


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory, views: list[View]) -> Path:
    """A data folder with two versions of a map."""
    folder = tmp_path_factory.mktemp("built")
    with running(folder, run_worker=False) as server:
        server.add_venue(VENUE)
        server.add_maps(VENUE, *((zipped(scan_files(views[:count])), QUICK) for count in (4, 5)))
    return folder


def large_files(folder: Path) -> list[Path]:
    """Return the maps, the indices and the database: everything but pictures."""
    blobs = [path for path in (folder / "blobs").rglob("*") if path.is_file()]
    heads = {path: path.read_bytes()[:4] for path in blobs}
    maps = [path for path, head in heads.items() if head in (b"RFMA", b"IxF2")]
    return sorted([*maps, folder / "roomfix.db"])


@pytest.mark.parametrize("seed", range(ROUNDS))
def test_flipped_bytes_give_no_wrong_pose(built: Path, tmp_path: Path, views: list[View], seed: int) -> None:
    folder = Path(shutil.copytree(built, tmp_path / "data"))
    rng = np.random.default_rng(seed)
    files = large_files(folder)
    assert len(files) == 5
    path = files[seed % len(files)]
    data = bytearray(path.read_bytes())
    # The first page of a database is read by the migration at the start, which then refuses to start.
    first = 4096 if path.suffix == ".db" else 0
    for place in rng.integers(first, len(data), int(rng.integers(1, 200))):
        data[place] ^= int(rng.integers(1, 256))
    path.write_bytes(bytes(data))
    try:
        with running(folder, run_worker=False) as server:
            for view in (views[1], views[3]):
                answer = server.post_image(view.jpeg(), {"venue": VENUE, "camera": CAMERA_TEXT})
                check(answer, view)
            assert server.client.get("/healthz").status_code == 200
            assert server.client.get("/readyz").status_code in (200, 503)
    except Exception as error:
        # A damaged database may keep the server from starting, with an error that says so.
        if path.suffix != ".db" or isinstance(error, AssertionError):
            raise


def check(answer: httpx.Response, view: View) -> None:
    if answer.status_code == 200:
        body = answer.json()
        assert not body["located"] or pose_errors(body, view.world_from_camera)[0] < 0.05
    else:
        assert (answer.status_code, answer.json()["code"] in CLEAR) == (503, True), answer.text
