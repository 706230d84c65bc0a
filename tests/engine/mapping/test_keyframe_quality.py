"""Poor keyframes are left out, named, and replaced by the frame beside them where nothing else covers the place."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pytest

from app.engine.mapping.build_map import BuiltMap, build_map
from app.engine.mapping.keyframe_quality import find_replacements
from app.engine.mapping.options import BuildOptions
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import NoProgress
from app.errors import InvalidScanError
from app.geometry.camera_hint import hint_of
from app.geometry.se3 import Pose
from app.importers.frames import Scan, ScanOptions
from app.importers.registry import open_scan
from app.vision.keyframes import PoseThresholds
from tests.scenes import CAMERA, Room, pose_at, scan_files

# By the pose rule, with its 0.176 m and 0.13 rad, these are keyframes and their neighbours in turn.
STEP_DEG = 5.0


def slow_walk(count: int = 12) -> list[Pose]:
    return [pose_at(1.4 + 0.02 * i, 1.3, yaw_deg=-20 + STEP_DEG * i) for i in range(count)]


@pytest.fixture(scope="module")
def files(room: Room) -> dict[str, bytes]:
    return scan_files([room.view(pose) for pose in slow_walk()])


def name(i: int) -> str:
    return f"rgb/{i / 10:.6f}.png"


def spoiled(files: dict[str, bytes], rows: list[int], dark: bool = False) -> dict[str, bytes]:
    """Return the files with these frames blurred, or black."""
    out = dict(files)
    for row in rows:
        image = cv2.imdecode(np.frombuffer(out[name(row)], np.uint8), cv2.IMREAD_COLOR)
        assert image is not None
        image = np.zeros_like(image) if dark else cv2.GaussianBlur(image, (0, 0), 9)
        out[name(row)] = cv2.imencode(".png", image)[1].tobytes()
    return out


def scan_in(folder: Path, files: dict[str, bytes]) -> Scan:
    for path, data in files.items():
        (folder / path).parent.mkdir(exist_ok=True)
        (folder / path).write_bytes(data)
    return open_scan(folder, "tum", ScanOptions(camera=hint_of(CAMERA)))


def built(scan: Scan) -> BuiltMap:
    with ThreadPoolExecutor(2) as executor:
        return build_map(scan, BuildOptions(), VisionModels(), executor, NoProgress())


def test_a_blurred_keyframe_gives_its_place_to_its_neighbour(tmp_path: Path, files: dict[str, bytes]) -> None:
    good = built(scan_in(tmp_path, files))
    names = [frame.name for frame in good.keyframes]
    assert names == [name(i) for i in range(0, 12, 2)]
    assert good.replaced == {}
    for dark, reason in ((False, "blurred"), (True, "badly_exposed")):
        found = built(scan_in(tmp_path, spoiled(files, [4], dark)))
        assert found.discarded[reason] == (name(4),)
        assert set(found.replaced) == {name(4)}
        assert found.replaced[name(4)] in (name(3), name(5))
        kept = [frame.name for frame in found.keyframes]
        assert kept == sorted({*names, found.replaced[name(4)]} - {name(4)})


def test_a_blurred_stretch_leaves_a_gap(tmp_path: Path, files: dict[str, bytes]) -> None:
    found = built(scan_in(tmp_path, spoiled(files, [3, 4, 5])))
    assert found.discarded["blurred"] == (name(4),)
    assert found.replaced == {}
    assert name(4) not in [frame.name for frame in found.keyframes]


def test_a_scan_in_the_dark_is_refused(tmp_path: Path, files: dict[str, bytes]) -> None:
    with pytest.raises(InvalidScanError, match="sharp and bright enough"):
        built(scan_in(tmp_path, spoiled(files, list(range(12)), dark=True)))


LIMITS = PoseThresholds(0.2, 0.15)


def test_the_nearest_good_frame_is_taken() -> None:
    poses = [pose_at(0.05 * i, 0.0) for i in range(20)]
    asked: list[int] = []

    def is_good(row: int) -> bool:
        asked.append(row)
        return row not in (9, 11)

    assert find_replacements([0, 10], [0], poses, LIMITS, is_good) == {10: 8}
    assert asked == [9, 11, 8]
    assert find_replacements([0, 10], [0], poses, LIMITS, lambda _: False) == {}


def test_a_covered_place_needs_no_replacement() -> None:
    poses = [pose_at(0.05 * i, 0.0) for i in range(20)]
    assert find_replacements([8, 10], [8], poses, LIMITS, lambda _: True) == {}
    # One stand-in may cover for two.
    assert find_replacements([9, 10], [], poses, LIMITS, lambda row: row == 12) == {9: 12}
    # Close in position only is not close.
    turned = [pose_at(0.0, 0.0), pose_at(0.0, 0.0, yaw_deg=20.0), pose_at(0.0, 0.0, yaw_deg=17.0)]
    assert find_replacements([0, 1], [0], turned, LIMITS, lambda _: True) == {1: 2}
