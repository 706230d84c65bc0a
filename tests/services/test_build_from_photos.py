"""Photos alone become a map that serves: in its own unit and without a plan, until its scale is stated."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest

from app.engine.mapping.structure import reconstruction
from app.engine.progress import NoProgress
from app.errors import InvalidScanError
from app.geometry.camera_hint import parse_camera_hint
from app.services.builds.run_build import run_build
from app.services.locate_result import LocateRequest
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.services.submit_build import submit_build
from app.services.wiring import wire_services
from app.settings import Settings
from app.storage.builds import Build, claim_build
from app.storage.maps import list_left_out, list_maps
from app.storage.venues import create_venue
from app.vision.images import decode_image, shrink
from tests.scenes import CAMERA_TEXT, Room, pose_at, scan_files, zipped


@pytest.fixture
def resources(tmp_path: Path) -> Resources:
    made = Resources.open(Settings(_env_file=None, data_dir=tmp_path, open=True))
    with made.database.write() as connection:
        create_venue(connection, "v", "V")
    return made


def claimed(resources: Resources, archive: bytes, options: dict[str, object]) -> Build:
    submit_build(resources, "v", options, io.BytesIO(archive))
    with resources.database.write() as connection:
        build = claim_build(connection)
    assert build is not None
    return build


def photos(count: int) -> dict[str, bytes]:
    room = Room(seed=4)
    poses = (pose_at(0.9 + 0.12 * i, 0.7 + 0.03 * i, 1.4, 62 + 3.0 * i, -4 + i % 4) for i in range(count))
    return {f"{i:03d}.png": room.view(pose).png() for i, pose in enumerate(poses)}


def test_photos_without_scale_give_poses_and_no_plan(resources: Resources) -> None:
    sent = photos(11)
    asked = sent.pop("005.png")
    # Of another place: nothing connects it with the others.
    elsewhere = Room(seed=9).view(pose_at(2.0, 1.5))
    sent["elsewhere.png"] = elsewhere.png()
    library = MapLibrary(resources)
    run_build(claimed(resources, zipped(sent), {}), resources, library, NoProgress())
    with resources.database.read() as connection:
        (version,) = list_maps(connection, "v")
        (left_out,) = list_left_out(connection, "v", 1)
    assert (left_out.reason, left_out.name, left_out.time_s) == ("unconnected", "elsewhere.png", None)
    small = decode_image(resources.blobs.get(left_out.picture_blob))
    assert np.abs(small.astype(int) - shrink(elsewhere.rgb, max(small.shape))[0]).mean() < 12
    assert version.statistics["structure"]["connected"] == 10
    assert version.statistics["structure"]["floor"] is None
    assert version.statistics["placement"]["has_scale"] is False
    assert any("no scale" in warning for warning in version.statistics["warnings"])
    request = LocateRequest(image=asked, venue="v", camera=parse_camera_hint(CAMERA_TEXT))
    answer = wire_services(resources).locate.locate(request)
    assert answer.world_from_camera is not None
    assert (answer.plan, answer.plan_reason, answer.floor) == (None, "scale_unknown", None)
    extending = claimed(resources, zipped(sent), {"mode": "extend"})
    with pytest.raises(InvalidScanError, match="without scale"):
        run_build(extending, resources, library, NoProgress())


def test_a_scale_for_a_scan_with_poses_is_refused(resources: Resources) -> None:
    view = Room(seed=4).view(pose_at(2.0, 1.0))
    build = claimed(resources, zipped(scan_files([view])), {"scale": {"marker_m": 0.1}})
    with pytest.raises(InvalidScanError, match="leave it out"):
        run_build(build, resources, MapLibrary(resources), NoProgress())


def test_without_pycolmap_the_sentence_says_what_to_install(
    resources: Resources, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reconstruction, "find_spec", lambda _: None)
    build = claimed(resources, zipped(photos(3)), {})
    with pytest.raises(InvalidScanError, match=r"pip install 'roomfix\[sfm\]'"):
        run_build(build, resources, MapLibrary(resources), NoProgress())
