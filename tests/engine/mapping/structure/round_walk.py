"""A walk around once and a little more, looking at a round wall whose second third is a copy of the first."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.structure.matches import MatchedPictures, Pair
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.vision.features import LocalFeatures
from tests.scenes import pose_at

Array = NDArray[np.float64]
CAMERA = Camera("PINHOLE", 640, 480, (500.0, 500.0, 319.5, 239.5))
# A walk around once and a little more, looking at a round wall.
FRAMES = 66
STEP_DEG = 6.0
TURN = 60
WALK_RADIUS_M = 4.0
WALL_RADIUS_M = 7.0
DRIFT_DEG = 0.04
# What is seen at 120 degrees is a copy of what is seen at the start.
COPY = 20


def true_pose(frame: int) -> Pose:
    """Return where the camera is, looking away from the centre."""
    angle = np.radians(STEP_DEG * frame)
    return pose_at(
        WALK_RADIUS_M * float(np.cos(angle)), WALK_RADIUS_M * float(np.sin(angle)), 1.5, STEP_DEG * frame, 0.0
    )


def drifted_pose(frame: int) -> Pose:
    """Return where the path says that it is: it turns a little too far with each frame."""
    turn = np.radians(DRIFT_DEG * frame)
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]])
    drift = Pose(rotation, np.array([0.004 * frame, 0.0, 0.002 * frame]))
    return drift @ true_pose(frame)


def make_wall() -> Array:
    """Points (n, 3) of the wall; the second third is the first one again, turned."""
    rng = np.random.default_rng(5)
    angle = rng.uniform(0, 2 * np.pi / 3, 3000)
    radius = WALL_RADIUS_M + rng.uniform(-0.8, 0.8, 3000)
    third = np.stack([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(0, 3, 3000)], axis=1)
    turn = np.radians(120.0)
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]])
    other = np.stack([radius * np.cos(-angle), radius * np.sin(-angle), rng.uniform(0, 3, 3000)], axis=1)
    return np.concatenate([third, third @ rotation.T, other])


def seen_rows(wall: Array, frame: int) -> NDArray[np.intp]:
    """Return the rows of the wall's points that a frame sees, at most 300 of them."""
    local = true_pose(frame).inverse().apply(wall)
    pixels = CAMERA.project(np.where(local[:, 2:] > 0.5, local, [0, 0, 1.0]))
    inside = (
        (local[:, 2] > 0.5) & (local[:, 2] < 5) & (pixels > 0).all(axis=1) & (pixels < [640, 480]).all(axis=1)
    )
    return np.flatnonzero(inside)[:: max(1, int(inside.sum()) // 300)]


def noisy_matches(frames: int, noise_px: float, seed: int) -> MatchedPictures:
    """Return the matches of each of the first pictures with the next three, their pixels with this noise."""
    wall, rng = make_wall(), np.random.default_rng(seed)
    rows = [seen_rows(wall, frame) for frame in range(frames)]
    features = []
    for frame, own in enumerate(rows):
        pixels = CAMERA.project(true_pose(frame).inverse().apply(wall[own]))
        noisy = (pixels + rng.normal(0, noise_px, pixels.shape)).astype(np.float32)
        features.append(LocalFeatures(noisy, np.zeros((len(own), 1), np.float32)))
    return MatchedPictures(tuple(features), matches_beside(rows))


def matches_beside(rows: Sequence[NDArray[np.intp]]) -> dict[Pair, NDArray[np.intp]]:
    """Return the matches of each picture with the next three, by the rows of the points that each one sees."""
    matches: dict[Pair, NDArray[np.intp]] = {}
    for i in range(len(rows)):
        for j in range(i + 1, min(len(rows), i + 4)):
            _, a, b = np.intersect1d(rows[i], rows[j], return_indices=True)
            matches[i, j] = np.stack([a, b], axis=1)
    return matches
