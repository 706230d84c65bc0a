"""Features without depth get that of their points, by other views; what views don't determine stays without."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from app.engine.mapping.triangulated_depth import with_triangulated_depth
from app.engine.maps.points import View
from app.engine.progress import NoProgress
from app.geometry.depth import sample_depth
from app.geometry.se3 import Pose
from app.vision.images import to_gray
from app.vision.local_features import RootSift
from tests.scenes import CAMERA, Room, pose_at

EXTRACTOR = RootSift(max_features=300)
ALONG = [pose_at(1.0, 0.6 + 0.15 * i, 1.3, yaw_deg=3.0 * (i % 3) - 3) for i in range(7)]


def views_from(
    poses: Sequence[Pose],
) -> tuple[list[View], list[np.ndarray[tuple[int], np.dtype[np.float32]]]]:
    """Return views without depth, and the true depths of their features."""
    room, views, truths = Room(3), [], []
    for pose in poses:
        seen = room.view(pose)
        features = EXTRACTOR.extract(to_gray(seen.rgb))
        truths.append(sample_depth(seen.depth_m.astype(np.float32), features.keypoints_px))
        views.append(View(seen.world_from_camera, features, np.zeros(len(features), np.float32)))
    return views, truths


def triangulated(views: Sequence[View]) -> list[View]:
    with ThreadPoolExecutor(1) as executor:
        found = with_triangulated_depth(dict(enumerate(views)), CAMERA, EXTRACTOR, executor, NoProgress())
    return [found[i] for i in range(len(views))]


@pytest.fixture(scope="module")
def scene() -> tuple[list[View], list[np.ndarray[tuple[int], np.dtype[np.float32]]]]:
    return views_from(ALONG)


def test_depths_are_those_of_the_scene(
    scene: tuple[list[View], list[np.ndarray[tuple[int], np.dtype[np.float32]]]],
) -> None:
    views, truths = scene
    for view, truth in zip(triangulated(views), truths, strict=True):
        found = (view.depth_m > 0) & (truth > 0)
        assert found.mean() > 0.3
        errors = np.abs(np.log(view.depth_m[found] / truth[found]))
        assert np.median(errors) < 0.005
        assert np.quantile(errors, 0.95) < 0.06


def test_depth_that_is_known_stays(
    scene: tuple[list[View], list[np.ndarray[tuple[int], np.dtype[np.float32]]]],
) -> None:
    views, truths = scene
    known = [replace(view, depth_m=truth) for view, truth in zip(views, truths, strict=True)]
    for view, truth in zip(triangulated(known), truths, strict=True):
        assert np.array_equal(view.depth_m[truth > 0], truth[truth > 0])


def test_a_turning_camera_determines_nothing() -> None:
    views, _ = views_from([pose_at(1.0, 1.0, 1.3, yaw_deg=4.0 * i) for i in range(4)])
    assert not any(view.depth_m.any() for view in triangulated(views))


def test_wrong_poses_determine_little(
    scene: tuple[list[View], list[np.ndarray[tuple[int], np.dtype[np.float32]]]],
) -> None:
    views, _ = scene
    rng = np.random.default_rng(2)
    shaken = [
        replace(view, world_from_camera=view.world_from_camera @ Pose(np.eye(3), rng.normal(0, 0.15, 3)))
        for view in views
    ]
    right = sum(np.count_nonzero(view.depth_m) for view in triangulated(views))
    wrong = sum(np.count_nonzero(view.depth_m) for view in triangulated(shaken))
    assert wrong < 0.3 * right
