"""All views of a scan together: they find out what is wrong with the sensor, and keyframes get what others saw."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from numpy.typing import NDArray

from app.engine.mapping.refine_scan import refined_scan
from app.engine.mapping.sensor_depth import corrected, learn_depth_response
from app.engine.maps.points import View, nearby_views, points_from_depth
from app.engine.progress import NoProgress
from app.geometry.depth import sample_depth
from app.geometry.depth_response import DepthResponse
from app.vision.images import to_gray
from app.vision.local_features import RootSift
from tests.scenes import CAMERA, Room, pose_at

# What the sensor shows over what there is, at depth z': 1.03 at no depth, 1.09 at 3 m, more to the right.
RESPONSE = DepthResponse((1.03, 0.02, 0.03, 0.0))
# So few that keyframes have room.
EXTRACTOR = RootSift(max_features=250)


@pytest.fixture(scope="module")
def views() -> list[View]:
    """Views along a wall and towards it, by a sensor that shows what `RESPONSE` says."""
    room, out = Room(3), []
    for i in range(8):
        view = room.view(
            pose_at(1.0 + 0.05 * (i % 4), 0.6 + 0.2 * i, 1.3 + 0.1 * (i % 3), yaw_deg=4.0 * (i % 3) - 4)
        )
        features = EXTRACTOR.extract(to_gray(view.rgb))
        depth_m = sample_depth(view.depth_m.astype(np.float32), features.keypoints_px)
        out.append(
            View(view.world_from_camera, features, shown(depth_m, CAMERA.normalize(features.keypoints_px)))
        )
    return out


def shown(depth_m: NDArray[np.float32], image_plane: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return what the sensor shows where the depths are these: z' = z (a + b z' + c x), solved for z'."""
    a, b, c, _ = RESPONSE.coefficients
    return np.asarray(depth_m * (a + c * image_plane[:, 0]) / (1 - b * depth_m), dtype=np.float32)


def off_the_walls(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far points (n, 3) are from the nearest wall, floor or ceiling of the room."""
    return np.asarray(np.minimum(np.abs(points), np.abs(points - Room(3).size_m)).min(axis=1))


def test_a_scan_finds_out_what_its_sensor_shows(views: list[View]) -> None:
    poses = [view.world_from_camera for view in views]
    seen_by = [[views[i] for i in nearby_views(pose, poses)] for pose in poses]
    with ThreadPoolExecutor(1) as executor:
        found = learn_depth_response(views, seen_by, CAMERA, EXTRACTOR, executor, NoProgress())
    for view in views:
        before = np.median(off_the_walls(points_from_depth(view, CAMERA).points_in_world))
        after = np.median(
            off_the_walls(points_from_depth(corrected(view, found, CAMERA), CAMERA).points_in_world)
        )
        assert before > 0.08
        assert after < 0.01


def test_without_parallax_the_sensor_is_left_as_it_is(views: list[View]) -> None:
    with ThreadPoolExecutor(1) as executor:
        found = learn_depth_response(views[:1], [views[:1]], CAMERA, EXTRACTOR, executor, NoProgress())
    assert found == DepthResponse()


def test_keyframes_get_what_sharp_frames_between_them_saw(views: list[View]) -> None:
    by_row = dict(enumerate(views))
    with ThreadPoolExecutor(1) as executor:
        alone = refined_scan(by_row, [1, 6], [1, 6], CAMERA, EXTRACTOR, executor, NoProgress())
        filled = refined_scan(by_row, [1, 6], list(range(8)), CAMERA, EXTRACTOR, executor, NoProgress())
    for own, more in zip(alone.points, filled.points, strict=True):
        count = len(own.features)
        assert len(more.features) > 1.2 * count
        # Its own come first and stay as they are.
        assert np.array_equal(more.points_in_world[:count], own.points_in_world)
        lent = more.points_in_world[count:]
        assert np.median(off_the_walls(lent)) < 0.01
        assert CAMERA.contains(more.features.keypoints_px.astype(np.float64)).all()
