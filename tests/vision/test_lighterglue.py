"""LighterGlue on pictures of one thing, and on too little."""

from __future__ import annotations

import numpy as np
import pytest

from app.vision.images import to_gray
from app.vision.learned.lighterglue import LighterGlue, PictureFeatures
from app.vision.local_features import XFeat
from tests.scenes import CAMERA, Room, pose_at


@pytest.fixture(scope="module")
def network() -> LighterGlue:
    return LighterGlue()


def features_of(room: Room, yaw_deg: float) -> PictureFeatures:
    found = XFeat(300).extract(to_gray(room.view(pose_at(1.4, 1.3, yaw_deg=yaw_deg)).rgb))
    return PictureFeatures(found.keypoints_px, np.asarray(found.descriptors), (CAMERA.width, CAMERA.height))


def test_a_turn_moves_all_matches_alike(network: LighterGlue, room: Room) -> None:
    a, b = features_of(room, 0.0), features_of(room, 6.0)
    rows, theirs, probability = network.match(a, b)
    assert len(rows) > 60
    assert len(set(theirs.tolist())) == len(rows)
    assert probability.min() > 0.1
    assert probability.max() <= 1.0
    moved = b.keypoints_px[theirs] - a.keypoints_px[rows]
    assert np.mean(np.abs(moved[:, 0] - np.median(moved[:, 0])) < 6) > 0.9
    assert np.mean(np.abs(moved[:, 1]) < 6) > 0.9


def test_points_are_relative_to_the_middle_of_the_picture() -> None:
    corners = np.array([[0, 0], [320, 240], [160, 120]], np.float32)
    points = PictureFeatures(corners, np.zeros((3, 64), np.float32), (320, 240)).points
    assert points == pytest.approx(np.array([[-1, -0.75], [1, 0.75], [0, 0]]))


@pytest.mark.parametrize("count", [0, 1])
def test_too_little_matches_nothing(network: LighterGlue, room: Room, count: int) -> None:
    a = features_of(room, 0.0)
    few = PictureFeatures(a.keypoints_px[:count], a.descriptors[:count], a.size_px)
    for pair in ((a, few), (few, a)):
        assert [len(each) for each in network.match(*pair)] == [0, 0, 0]
