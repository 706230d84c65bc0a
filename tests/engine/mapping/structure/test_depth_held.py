"""Depth images keep the scale of a path from drifting, and a path that they contradict is refused."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from app.engine.mapping.structure.depth.held import OPTIONS, held_to_depth
from app.engine.mapping.structure.depth.measured import depth_ratios
from app.engine.mapping.structure.estimate import estimate_poses
from app.engine.mapping.structure.reconstruction import Reconstruction
from app.errors import CancelledBuildError
from app.geometry.camera_hint import hint_of
from app.geometry.depth import DepthImage
from app.geometry.se3 import Pose
from app.importers.frames import ScanOptions
from app.importers.registry import open_scan, open_unposed
from tests.engine.mapping.structure.floor.corridor_walk import CAMERA, DOORS, FRAMES, STEP_M, Corridor
from tests.engine.mapping.structure.test_estimate import poses as walk
from tests.rendered_maps import models
from tests.scenes import CAMERA as ROOM_CAMERA
from tests.scenes import Room, scan_files

pytest.importorskip("pycolmap")
CORRIDOR = Corridor()
# The second room's scale over the first one's.
SLIDE = 1.4
# The unit of the whole path.
UNIT_M = 0.5
NOISE_PX = 0.5


@pytest.fixture(scope="module")
def slid() -> Reconstruction:
    """A path whose second room is too large, in a unit of its own."""
    part = CORRIDOR.slid(SLIDE)
    poses = {row: Pose(pose.rotation, pose.translation / UNIT_M) for row, pose in part.poses.items()}
    return replace(part, poses=poses, points=part.points / UNIT_M)


@pytest.fixture(scope="module")
def keypoints_px(slid: Reconstruction) -> list[NDArray[np.float64]]:
    """The pixels (n, 2) of the features of each picture."""
    rng, points = np.random.default_rng(1), CORRIDOR.points()
    found = []
    for row in range(FRAMES):
        seen = points[slid.observations[slid.observations[:, 0] == row, 2]]
        exact = CAMERA.project(CORRIDOR.true_pose(row).inverse().apply(seen))
        found.append(exact + rng.normal(0, NOISE_PX, exact.shape))
    return found


class Depths:
    """Depth images that measured at features alone, of each picture at no more than `most`."""

    def __init__(
        self, part: Reconstruction, keypoints_px: list[NDArray[np.float64]], most: int | None = None
    ) -> None:
        self._part, self._pixels, self._most = part, keypoints_px, most

    def __call__(self, row: int) -> DepthImage:
        """Return the depth image of a picture."""
        part, image = self._part, np.zeros((CAMERA.height, CAMERA.width), np.float32)
        points = CORRIDOR.points()[part.observations[part.observations[:, 0] == row, 2]]
        depths = CORRIDOR.true_pose(row).inverse().apply(points)[:, 2][: self._most]
        for (u, v), depth_m in zip(np.floor(self._pixels[row]).astype(int), depths, strict=False):
            image[max(v, 0) : v + 2, max(u, 0) : u + 2] = depth_m
        return image


def held(
    part: Reconstruction, keypoints_px: list[NDArray[np.float64]], depths: Depths, reports: list[None]
) -> Reconstruction:
    return held_to_depth(
        part, keypoints_px, depths, CAMERA, is_calibrated=True, report=lambda: reports.append(None)
    )


def steps_m(part: Reconstruction) -> list[float]:
    """Return the median step from picture to picture in each room."""
    places = np.array([part.poses[row].translation for row in range(FRAMES)])
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    return [float(np.median(each)) for each in np.split(steps, DOORS)]


def test_a_path_whose_scale_drifts_is_led_back(
    slid: Reconstruction, keypoints_px: list[NDArray[np.float64]]
) -> None:
    depths, reports = Depths(slid, keypoints_px), list[None]()
    assert steps_m(slid) == pytest.approx([STEP_M / UNIT_M, SLIDE * STEP_M / UNIT_M, STEP_M / UNIT_M])
    part = held(slid, keypoints_px, depths, reports)
    assert steps_m(part) == pytest.approx([STEP_M] * 3, rel=0.01)
    measured = depth_ratios(part, depths)
    assert measured.metres_per_unit == pytest.approx(1.0, abs=0.01)
    assert measured.deviation < 0.005
    # Points that one picture alone sees are not tied.
    assert np.bincount(part.observations[:, 2]).min() > 1
    assert 0.9 * len(slid.observations) < len(part.observations) < len(slid.observations)
    # The noise of the features, less what the points follow of it.
    noise_px = NOISE_PX * np.sqrt(np.pi / 2)
    assert 0.9 * noise_px < part.error_px < noise_px
    assert reports


def test_a_path_with_few_depths_stays(slid: Reconstruction, keypoints_px: list[NDArray[np.float64]]) -> None:
    few = Depths(slid, keypoints_px, most=1)
    assert len(depth_ratios(slid, few).ratios) < OPTIONS.min_depths
    assert held(slid, keypoints_px, few, []).poses is slid.poses


def test_a_stop_is_heard(slid: Reconstruction, keypoints_px: list[NDArray[np.float64]]) -> None:
    def stop() -> None:
        raise CancelledBuildError

    with pytest.raises(CancelledBuildError):
        held_to_depth(slid, keypoints_px, Depths(slid, keypoints_px), CAMERA, is_calibrated=True, report=stop)


class Stages:
    """A progress that keeps the names of its stages."""

    def __init__(self) -> None:
        self.names: set[str] = set()

    def report(self, stage: str, done: int, total: int) -> None:
        """Keep the name."""
        self.names.add(stage)


def test_a_scan_with_depth_is_held_to_it(tmp_path: Path) -> None:
    for path, data in scan_files([Room(seed=4).view(pose) for pose in walk()]).items():
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_bytes(data)
    posed = ScanOptions(camera=hint_of(ROOM_CAMERA), scratch=tmp_path)
    unposed, stages = open_unposed(tmp_path, "tum", replace(posed, estimate_poses=True)), Stages()
    assert unposed is not None
    with ThreadPoolExecutor(1) as executor:
        found = estimate_poses(unposed, None, models(), executor, stages)
    true = {frame.name: frame.scan_from_camera for frame in open_scan(tmp_path, "tum", posed).frames}
    first, *_, last = found.scan.frames
    own, walked = (
        np.linalg.norm(b.translation - a.translation)
        for a, b in ((first.scan_from_camera, last.scan_from_camera), (true[first.name], true[last.name]))
    )
    assert own == pytest.approx(walked, rel=0.02)
    assert found.report["scale"]["median_deviation"] < 0.01
    assert "hold_to_depth" in stages.names
