"""Matches of feature methods, counted and drawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.vision.images import decode_image
from app.vision.local_features import create_extractor
from bench.anchors.features import PosedPictures, match_quality, matches_of
from bench.anchors.match_pictures import draw_matches

CAMERA = Camera("PINHOLE", 320, 240, (300.0, 300.0, 159.5, 119.5))
SHIFT_PX = 30


def shifted_wall() -> PosedPictures:
    """A wall 3 m away, and a camera 0.3 m to the right of the first: the picture moves by 30 pixels."""
    noise = np.random.default_rng(2).integers(0, 256, (30, 44), dtype=np.uint8)
    wall = np.kron(noise, np.ones((8, 8), np.uint8))
    moved = Pose(np.eye(3), np.array([-0.3, 0.0, 0.0]))
    first, second = wall[:240, :320], wall[:240, SHIFT_PX : SHIFT_PX + 320]
    return PosedPictures(first, second, CAMERA, CAMERA, moved)


def test_matches_are_right_where_the_true_pose_puts_them() -> None:
    method, pair = create_extractor("orb"), shifted_wall()
    found = matches_of(method, pair)
    assert found.right.mean() > 0.8
    assert np.median(found.first_px[:, 0] - found.second_px[:, 0]) == SHIFT_PX
    assert match_quality(method, [pair]).right == found.right.sum()


def test_each_method_has_its_panel(tmp_path: Path) -> None:
    methods = [create_extractor(name) for name in ("orb", "akaze")]
    draw_matches(methods[:1], shifted_wall(), tmp_path / "one.png")
    draw_matches(methods, shifted_wall(), tmp_path / "two.png")
    one, two = (decode_image((tmp_path / name).read_bytes()) for name in ("one.png", "two.png"))
    assert two.shape[0] == 2 * one.shape[0]
    # Green lines, which a grey picture has none of.
    red, green = two[..., 0].astype(int), two[..., 1].astype(int)
    assert np.count_nonzero(green - red > 60) > 200
