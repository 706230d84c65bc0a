"""A map whose files were changed on disk: the version before serves, or a clear 503; never a wrong pose."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import create_engine, select

from app.engine.maps.artifact import MapArtifact
from app.storage.tables import map_versions
from tests.maps import write_without_checksums
from tests.scenes import View, scan_files, zipped
from tests.server import QUICK, Server, assert_problem, pose_errors, running

VENUE = "v"


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory, views: list[View]) -> Path:
    """A data folder whose venue has two versions of its map."""
    folder = tmp_path_factory.mktemp("built")
    with running(folder, run_worker=False) as server:
        server.add_venue(VENUE)
        server.add_maps(VENUE, *((zipped(scan_files(views[:count])), QUICK) for count in (4, 5)))
    return folder


@pytest.fixture
def folder(built: Path, tmp_path: Path) -> Path:
    """A copy of that folder."""
    return Path(shutil.copytree(built, tmp_path / "data"))


def blob_of(folder: Path, version: int, column: str) -> Path:
    """Return the file of a version's artefact or index."""
    engine = create_engine(f"sqlite:///{folder / 'roomfix.db'}")
    with engine.connect() as connection:
        digest = connection.execute(
            select(map_versions.c[column]).where(map_versions.c.version == version)
        ).scalar_one()
    engine.dispose()
    return folder / "blobs" / "sha256" / digest[:2] / digest


def move_points(path: Path) -> None:
    """Move all points of a map by a metre, as an editor of the file would."""
    points = np.array(MapArtifact.open(path).arrays.points_in_world)
    data = path.read_bytes()
    first = data.index(points.tobytes())
    moved = (points + np.float32(1.0)).tobytes()
    path.write_bytes(data[:first] + moved + data[first + len(moved) :])


def flip(path: Path) -> None:
    """Change twenty bytes all over a file."""
    data = bytearray(path.read_bytes())
    for place in np.linspace(0, len(data) - 1, 20).astype(int):
        data[place] ^= 0x41
    path.write_bytes(bytes(data))


def cut(path: Path) -> None:
    """Cut a file short."""
    path.write_bytes(path.read_bytes()[:-1000])


DAMAGE: dict[str, tuple[str, Callable[[Path], object]]] = {
    "moved points": ("artifact_blob", move_points),
    "flipped map": ("artifact_blob", flip),
    "cut map": ("artifact_blob", cut),
    "deleted map": ("artifact_blob", Path.unlink),
    "flipped index": ("index_blob", flip),
    "cut index": ("index_blob", cut),
    "deleted index": ("index_blob", Path.unlink),
}


def located_by(server: Server, view: View) -> int:
    """Locate a view, check that the pose is right, and return the version that answered."""
    result = server.locate(view.jpeg(), venue=VENUE)
    assert result["located"], result["reason"]
    assert pose_errors(result, view.world_from_camera)[0] < 0.03
    return int(result["map_version"])


@pytest.mark.parametrize("case", DAMAGE)
def test_the_version_before_a_damaged_one_serves(folder: Path, views: list[View], case: str) -> None:
    column, damage = DAMAGE[case]
    damage(blob_of(folder, 2, column))
    with running(folder, run_worker=False) as server:
        assert located_by(server, views[3]) == 1
        ready = server.client.get("/readyz")
        assert (ready.status_code, ready.json()["status"]) == (200, "degraded")
        assert "Version 1 serves" in ready.json()["checks"]["maps"]


def test_a_venue_without_a_whole_map_is_a_clear_503(folder: Path, views: list[View]) -> None:
    move_points(blob_of(folder, 2, "artifact_blob"))
    flip(blob_of(folder, 1, "index_blob"))
    with running(folder, run_worker=False) as server:
        answer = server.post_image(views[3].jpeg(), {"venue": VENUE})
        assert "backup" in assert_problem(answer, 503, "map_damaged")
        assert int(answer.headers["retry-after"]) > 0
        assert server.client.get("/healthz").status_code == 200
        # Rolling back doesn't help; building again does.
        assert server.client.post(f"/venues/{VENUE}/maps/1/activate").status_code == 200
        assert_problem(server.post_image(views[3].jpeg(), {"venue": VENUE}), 503, "map_damaged")


def test_a_map_without_checksums_of_its_own_is_compared_with_its_name(
    folder: Path, views: list[View]
) -> None:
    path = blob_of(folder, 2, "artifact_blob")
    write_without_checksums(MapArtifact.open(path), path)
    with running(folder, run_worker=False) as server:
        assert located_by(server, views[3]) == 1


def test_a_whole_map_is_ready(folder: Path, views: list[View]) -> None:
    with running(folder, run_worker=False) as server:
        assert located_by(server, views[3]) == 2
        checks = server.client.get("/readyz").json()["checks"]
        assert {name: checks[name] for name in ("database", "blobs", "models", "maps", "build_worker")} == {
            "database": "ok", "blobs": "ok", "models": "ok", "maps": "ok", "build_worker": "ok",
        }  # fmt: skip


def test_a_deleted_venue_takes_its_files_along_and_no_others(folder: Path, views: list[View]) -> None:
    with running(folder, run_worker=False) as server:
        server.add_venue("other")
        # The same pictures as the first venue's: stored once, for both.
        server.add_map(zipped(scan_files(views[:4])), "other", **QUICK)
        before = {name for name in server.files() if name.startswith("blobs")}
        assert server.client.delete(f"/venues/{VENUE}").status_code == 204
        left = {name for name in server.files() if name.startswith("blobs")}
        assert left < before
        assert server.locate(views[3].jpeg(), venue="other")["located"]
        assert server.client.delete("/venues/other").status_code == 204
        assert not {name for name in server.files() if name.startswith("blobs")}
