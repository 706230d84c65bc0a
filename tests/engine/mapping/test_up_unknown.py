"""A scan that doesn't say which way is up: its map doesn't depend on how its axes lie."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from app.engine.mapping.build_map import build_map, states_up
from app.engine.mapping.extend_map import join_maps
from app.engine.mapping.options import BuildOptions, parse_build_options
from app.engine.maps.artifact import MapArtifact
from app.engine.progress import NoProgress
from app.geometry.camera_hint import hint_of
from app.geometry.se3 import Pose, rotation_from_vector
from app.importers.frames import ScanOptions
from app.importers.registry import open_scan
from app.vision.index import GlobalIndex
from app.vision.repetition import PLACE
from tests.rendered_maps import models
from tests.scenes import CAMERA, Room, pose_at, scan_files

# A scan in a frame whose y axis points up.
Y_UP = Pose(rotation_from_vector([-np.pi / 2, 0.0, 0.0]), np.zeros(3))
STATED = parse_build_options({"gravity": [0.0, -1.0, 0.0]})


def built(
    folder: Path, room: Room, scan_from_world: Pose | None = None, options: BuildOptions | None = None
) -> tuple[MapArtifact, GlobalIndex]:
    """Return the map of four views of a room, scanned in another frame where one is given."""
    views = [room.view(pose_at(1.4 + 0.1 * i, 1.3, yaw_deg=-20 + 20 * i)) for i in range(4)]
    folder.mkdir(exist_ok=True)
    for path, data in scan_files(views, scan_from_world).items():
        (folder / path).parent.mkdir(exist_ok=True)
        (folder / path).write_bytes(data)
    scan = open_scan(folder, "tum", ScanOptions(camera=hint_of(CAMERA)))
    with ThreadPoolExecutor(1) as executor:
        made = build_map(scan, options or BuildOptions(), models(), executor, NoProgress())
    return made.artifact, made.index


@pytest.fixture(scope="module")
def lying(room: Room, tmp_path_factory: pytest.TempPathFactory) -> tuple[MapArtifact, GlobalIndex]:
    return built(tmp_path_factory.mktemp("lying"), room, Y_UP)


def test_axes_do_not_matter_where_up_is_not_known(
    lying: tuple[MapArtifact, GlobalIndex], room: Room, tmp_path: Path
) -> None:
    upright = built(tmp_path, room)[0]
    assert not upright.metadata.z_up
    assert not lying[0].metadata.z_up
    a, b = upright.arrays.distance_elsewhere, lying[0].arrays.distance_elsewhere
    assert a.shape == b.shape
    assert np.mean(a == b) > 0.98


def test_gravity_makes_height_count(
    lying: tuple[MapArtifact, GlobalIndex], room: Room, tmp_path: Path
) -> None:
    stated = built(tmp_path, room, Y_UP, STATED)
    assert stated[0].metadata.z_up
    assert np.array_equal(PLACE.axis_weights(True), [1.0, 1.0, PLACE.height_weight])
    assert np.array_equal(PLACE.axis_weights(False), [1.0, 1.0, 1.0])
    # Things of one room that are 1.4 m above each other are at different places only then.
    known, unknown = stated[0].arrays.distance_elsewhere, lying[0].arrays.distance_elsewhere
    assert np.median(known.astype(np.float64)) < np.median(unknown.astype(np.float64))


def test_it_is_kept_with_the_map(lying: tuple[MapArtifact, GlobalIndex], room: Room, tmp_path: Path) -> None:
    lying[0].write(tmp_path / "map")
    assert not MapArtifact.open(tmp_path / "map").metadata.z_up
    assert not join_maps(*lying, *lying, binary=False)[0].metadata.z_up
    stated = built(tmp_path / "scan", room, Y_UP, STATED)
    assert join_maps(*lying, *stated, binary=False)[0].metadata.z_up


def test_a_placement_in_the_world_states_it_too(room: Room, tmp_path: Path) -> None:
    for path, data in scan_files([room.view(pose_at(1.4, 1.3))]).items():
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_bytes(data)
    scan = open_scan(tmp_path, "tum", ScanOptions(camera=hint_of(CAMERA)))
    placed = parse_build_options({"world_from_scan": np.eye(4).tolist()})
    assert [states_up(options, scan) for options in (BuildOptions(), placed, STATED)] == [False, True, True]
