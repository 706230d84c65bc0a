"""A walk through three rooms, through doors at which hardly anything is seen from both sides, so that scales slide."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.structure.matches import MatchedPictures
from app.engine.mapping.structure.reconstruction import Reconstruction
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.vision.features import LocalFeatures
from tests.engine.mapping.structure.round_walk import matches_beside
from tests.scenes import pose_at

Array = NDArray[np.float64]
CAMERA = Camera("PINHOLE", 640, 480, (500.0, 500.0, 319.5, 239.5))
FRAMES = 120
DOORS = (40, 80)
STEP_M = 0.2
HEIGHT_M = 1.5
# The phone looks down a little, so that it sees the floor.
PITCH_DEG = -20.0
SIGHT_M = 6.0
NOISE_PX = 0.5
POINTS = 6000
DOWN = (0.0, 0.0, -1.0)


@dataclass(frozen=True)
class Corridor:
    """Three rooms along x. The floor of the second one is higher by `rise_m`, and so is the camera there.

    A share of the points is on the floor, the others are on the walls. `seen_through` are seen from both sides of a
    door.
    """

    rise_m: float = 0.0
    floor_share: float = 0.5
    seen_through: int = 12

    def true_pose(self, frame: int) -> Pose:
        """Return where the camera is."""
        return pose_at(STEP_M * frame, 0.0, HEIGHT_M + self.rise_m * (_room(frame) == 1), 0.0, PITCH_DEG)

    def slid_pose(self, frame: int, slide: float) -> Pose:
        """Return where a path has it whose scale is larger by this ratio in the second room."""
        pose = self.true_pose(frame)
        return Pose(pose.rotation, self._slid(pose.translation, _room(frame), slide))

    def _slid(self, place: Array, room: int, slide: float) -> Array:
        first, second = (self.true_pose(door).translation for door in DOORS)
        if room == 0:
            return place
        return first + slide * ((place if room == 1 else second) - first) + (room == 2) * (place - second)

    def points(self) -> Array:
        """Return points (n, 3) of the floor and the walls."""
        rng = np.random.default_rng(7)
        x, side = rng.uniform(-1, STEP_M * FRAMES + 6, POINTS), rng.choice([-1.5, 1.5], POINTS)
        floor = np.stack([x, rng.uniform(-1.5, 1.5, POINTS), np.zeros(POINTS)], axis=1)
        walls = np.stack([x, side, rng.uniform(0.1, 2.6, POINTS)], axis=1)
        points = np.where((rng.uniform(size=POINTS) < self.floor_share)[:, None], floor, walls)
        points[:, 2] += self.rise_m * (_rooms(points) == 1)
        return points

    def matches(self) -> MatchedPictures:
        """Return the matches of each picture with the next three; few of those before the door with those behind it."""
        points, rng = self.points(), np.random.default_rng(3)
        rooms = _rooms(points)
        doors = [np.abs(points[:, 0] - STEP_M * (door + 9)) < 2 for door in DOORS]
        through = np.concatenate([np.flatnonzero(near)[::60][: self.seen_through] for near in doors])
        features, rows = [], []
        for frame in range(FRAMES):
            seen = rooms == _room(frame)
            seen[through] = True
            own, pixels = self._seen(points, frame, seen)
            noisy = pixels + rng.normal(0, NOISE_PX, pixels.shape)
            features.append(LocalFeatures(noisy.astype(np.float32), np.zeros((len(own), 1), np.float32)))
            rows.append(own)
        return MatchedPictures(tuple(features), matches_beside(rows))

    def _seen(self, points: Array, frame: int, may: NDArray[np.bool_]) -> tuple[NDArray[np.intp], Array]:
        local = self.true_pose(frame).inverse().apply(points)
        ahead = (local[:, 2] > 0.3) & (local[:, 2] < SIGHT_M)
        pixels = CAMERA.project(np.where(ahead[:, None], local, [0, 0, 1.0]))
        inside = ahead & may & (pixels > 0).all(axis=1) & (pixels < [640, 480]).all(axis=1)
        return np.flatnonzero(inside), pixels[inside]

    def slid(self, slide: float) -> Reconstruction:
        """Return the path whose scale slides, with the points that its pictures see."""
        points = self.points()
        rooms = _rooms(points)
        moved = np.array([self._slid(point, room, slide) for point, room in zip(points, rooms, strict=True)])
        rows = [self._seen(points, frame, rooms == _room(frame))[0] for frame in range(FRAMES)]
        seen = np.concatenate(
            [
                np.stack([np.full(len(own), frame), np.arange(len(own)), own], axis=1)
                for frame, own in enumerate(rows)
            ]
        )
        poses = {frame: self.slid_pose(frame, slide) for frame in range(FRAMES)}
        return Reconstruction(camera=CAMERA, poses=poses, points=moved, observations=seen, error_px=0.5)

    def slide_of(self, part: Reconstruction) -> float:
        """Return the scale of a path in the second room relative to that in the first one."""
        scales = []
        for first, last in ((5, DOORS[0] - 5), (DOORS[0] + 5, DOORS[1] - 5)):
            own = part.poses[last].translation - part.poses[first].translation
            true = self.true_pose(last).translation - self.true_pose(first).translation
            scales.append(float(np.linalg.norm(own) / np.linalg.norm(true)))
        return scales[1] / scales[0]


def _room(frame: int) -> int:
    return sum(frame >= door for door in DOORS)


def _rooms(points: Array) -> NDArray[np.intp]:
    return np.searchsorted(STEP_M * np.array(DOORS), points[:, 0])
