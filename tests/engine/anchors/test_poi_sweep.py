"""The length of a POI by a plane sweep of its region, where it stands out and where it doesn't."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.anchors.features import AnchorDescriber, AnchorFeatures
from app.engine.anchors.poi_sweep import OPTIONS, SweptLength, sweep_region
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.vision.dense_descriptors import DenseDescriptors
from app.vision.images import to_gray
from tests.scenes import Room, View, pose_at

CAMERA = Camera("PINHOLE", 640, 480, (525.0, 525.0, 319.5, 239.5))
REGION_PX = np.array([[260.0, 180.0], [380.0, 180.0], [380.0, 300.0], [260.0, 300.0]])
MIDDLE_PX = np.array([320.0, 240.0])
MONITOR = pose_at(0.6, 1.5, 1.4, 0.0)
PHONE = pose_at(0.9, 1.1, 1.4, 12.0)


@pytest.fixture(scope="module")
def describer() -> AnchorDescriber:
    return AnchorDescriber()


@pytest.fixture(scope="module")
def views(room: Room) -> tuple[View, View]:
    """What the monitoring camera and the phone see."""
    return room.view(MONITOR, CAMERA), room.view(PHONE, CAMERA)


def unit_pose(world_from_phone: Pose) -> tuple[Pose, float]:
    """Return the phone's pose beside the camera with a translation of length 1, and the length in metres."""
    relative = world_from_phone.inverse() @ MONITOR
    distance_m = float(np.linalg.norm(relative.translation))
    return Pose(relative.rotation, relative.translation / distance_m), distance_m


def monitor_features(describer: AnchorDescriber, view: View) -> AnchorFeatures:
    return describer.describe(view.rgb, CAMERA, [REGION_PX])


def swept(monitor: AnchorFeatures, dense: DenseDescriptors, relative: Pose) -> SweptLength | None:
    assert monitor.regions is not None
    return sweep_region(monitor.regions, MIDDLE_PX, 120.0, dense, (CAMERA, CAMERA), relative)


@pytest.mark.parametrize("roll_deg", [0.0, 30.0])
def test_a_region_is_as_far_away_as_it_is(
    describer: AnchorDescriber, views: tuple[View, View], roll_deg: float
) -> None:
    monitor = monitor_features(describer, views[0])
    # A picture that is turned before it is described keeps its own pixels.
    _, dense = describer.upright_xfeat(to_gray(views[1].rgb), roll_deg)
    relative, distance_m = unit_pose(PHONE)
    found = swept(monitor, dense, relative)
    assert found is not None
    # The camera looks straight at the wall.
    truth = float(views[0].depth_m[240, 320]) / distance_m
    assert abs(np.log(found.length / truth)) < 0.05
    assert OPTIONS.base_log_sigma < found.log_sigma < 0.2


def test_a_wrong_relative_pose_or_an_empty_wall_give_no_sure_length(
    describer: AnchorDescriber, views: tuple[View, View]
) -> None:
    monitor = monitor_features(describer, views[0])
    _, dense = describer.upright_xfeat(to_gray(views[1].rgb), 0.0)
    turned, _ = unit_pose(pose_at(0.9, 1.1, 1.4, 20.0, 5.0))
    assert swept(monitor, dense, turned) is None
    blank = replace(dense, cells=np.broadcast_to(dense.cells[:1, :1], dense.cells.shape))
    relative, _ = unit_pose(PHONE)
    found = swept(monitor, blank, relative)
    assert found is None or found.log_sigma > 0.25


def test_descriptors_of_regions_are_stored_and_read_again(
    describer: AnchorDescriber, views: tuple[View, View]
) -> None:
    features = monitor_features(describer, views[0])
    again = AnchorFeatures.unpack(features.pack())
    assert again is not None
    assert features.regions is not None
    assert again.regions is not None
    np.testing.assert_array_equal(again.regions.points_px, features.regions.points_px)
    np.testing.assert_allclose(again.regions.descriptors, features.regions.descriptors, atol=1e-3)
    assert describer.describe(views[0].rgb, CAMERA).regions is None
