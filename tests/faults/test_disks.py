"""A full disk and a read-only store: what was acknowledged stays, the rest is a clear answer, and queries go on."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from tests.scenes import View, scan_files, zipped
from tests.server import QUICK, Server, assert_problem, pose_errors, running

VENUE = "v"
SIZE_MB = 12


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A small disk of its own."""
    folder = tmp_path / "disk"
    folder.mkdir()
    made = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={SIZE_MB}m", "tmpfs", str(folder)],
        check=False,
        capture_output=True,
    )
    if made.returncode:
        pytest.skip("no disk can be mounted here")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


@pytest.fixture
def server(disk: Path, views: list[View]) -> Iterator[Server]:
    """A server on it, with a map."""
    with running(disk) as server:
        server.add_venue(VENUE)
        server.add_map(zipped(scan_files(views[:4])), VENUE, **QUICK)
        yield server


def located(server: Server, view: View) -> bool:
    result = server.locate(view.jpeg(), venue=VENUE)
    return bool(result["located"]) and pose_errors(result, view.world_from_camera)[0] < 0.05


def fill(disk: Path) -> Path:
    """Fill the disk to its last page."""
    path = disk / "filler"
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT)
    try:
        for size in (1 << 20, 1 << 12):
            with suppress(OSError):
                while os.write(descriptor, os.urandom(size)) == size:
                    pass
    finally:
        os.close(descriptor)
    return path


def test_a_full_disk_refuses_what_it_can_not_store(disk: Path, server: Server, views: list[View]) -> None:
    acknowledged = [name for name in map(str, range(3)) if server.add_venue(name)]
    filler = fill(disk)
    answers = [server.submit(zipped(scan_files(views[:8])), VENUE)]
    answers += [server.client.post("/venues", json={"id": f"n{i}", "name": "n" * 200}) for i in range(100)]
    assert_problem(answers[0], 507, "storage_full")
    assert {answer.status_code for answer in answers} <= {201, 507}
    acknowledged += [answer.json()["id"] for answer in answers if answer.status_code == 201]
    assert located(server, views[2])
    checks = server.client.get("/readyz").json()
    assert checks["status"] == "degraded"
    assert "full" in checks["checks"]["disk"]
    filler.unlink()
    assert server.build(zipped(scan_files(views[:4])), VENUE, **QUICK)["state"] == "succeeded"
    assert {venue["id"] for venue in server.client.get("/venues").json()} >= {VENUE, *acknowledged}


def test_a_read_only_store_serves_and_takes_no_scan(disk: Path, server: Server, views: list[View]) -> None:
    blobs = str(disk / "blobs")
    subprocess.run(["mount", "--bind", blobs, blobs], check=True)
    try:
        subprocess.run(["mount", "-o", "remount,ro,bind", blobs], check=True)
        assert_problem(server.submit(zipped(scan_files(views[:5])), VENUE), 503, "storage_failed")
        assert_problem(server.client.get("/readyz"), 503, "not_ready")
        assert located(server, views[2])
        assert server.client.post("/venues", json={"id": "n", "name": "n"}).status_code == 201
    finally:
        # The map that is open keeps the mount busy.
        subprocess.run(["umount", "--lazy", blobs], check=True)
    assert server.build(zipped(scan_files(views[:5])), VENUE, **QUICK)["state"] == "succeeded"
    assert server.client.get("/readyz").status_code == 200
