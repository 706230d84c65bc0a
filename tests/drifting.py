"""Paths that pass their places again, and drift that is added to them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from app.geometry.se3 import Pose, rotation_from_vector
from tests.scenes import pose_at


def around(rounds: int, count: int, radius_m: float = 0.7) -> list[Pose]:
    """Return a path of `count` poses around the middle of the room, looking outwards."""
    angles = np.linspace(0, 2 * np.pi * rounds, count, endpoint=False)
    return [
        pose_at(2.0 + radius_m * np.cos(a), 1.5 + radius_m * np.sin(a), 1.4, float(np.degrees(a)))
        for a in angles
    ]


def drifted(path: Sequence[Pose], stretched: float, turn_rad: float) -> list[Pose]:
    """Return a path whose steps are too long by a ratio and turned too far."""
    found = [path[0]]
    for a, b in pairwise(path):
        step = a.inverse() @ b
        turn = rotation_from_vector([0.0, turn_rad, 0.0])
        found.append(found[-1] @ Pose(turn @ step.rotation, (1 + stretched) * step.translation))
    return found
