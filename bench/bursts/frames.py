"""The frames of a burst: a query and those that were taken after it, none of them in the map."""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import numpy as np

from app.errors import InvalidInputError
from app.geometry.se3 import Pose, rotation_from_vector
from app.importers.frames import Frame

# Error of a phone's odometry over a burst: by the length of the motion, and of its rotation.
MOTION_ERROR_RATIO = 0.02
MOTION_ERROR_DEG = 0.1


def bursts(
    queries: Sequence[Frame], unmapped: Sequence[Frame], count: int, apart_s: float
) -> list[tuple[Frame, ...]]:
    """Return the bursts of the queries: each with the frames nearest to `apart_s` after the one before.

    Queries near the end, after which too few frames come, have none. Raises `InvalidInputError` when no query has one.
    """
    ordered = sorted(unmapped, key=lambda frame: frame.timestamp_s)
    found = [burst for query in queries if len(burst := _burst(query, ordered, count, apart_s)) == count]
    if not found:
        raise InvalidInputError(f"No query is followed by {count - 1} frames that are {apart_s:g} s apart.")
    return found


def _burst(query: Frame, ordered: Sequence[Frame], count: int, apart_s: float) -> tuple[Frame, ...]:
    burst = [query]
    while len(burst) < count:
        wanted_s = burst[-1].timestamp_s + apart_s
        near = [frame for frame in ordered if abs(frame.timestamp_s - wanted_s) < 0.5 * apart_s]
        if not near:
            break
        burst.append(min(near, key=lambda frame: abs(frame.timestamp_s - wanted_s)))
    return tuple(burst)


def noisy_motion(first_from_camera: Pose, seed: str) -> Pose:
    """Return a motion with the error of a phone's odometry; the same seed always gives the same error."""
    rng = np.random.default_rng(zlib.crc32(seed.encode()))
    length_m = float(np.linalg.norm(first_from_camera.translation))
    turn = rotation_from_vector(np.radians(MOTION_ERROR_DEG) / np.sqrt(3) * rng.normal(size=3))
    step_m = MOTION_ERROR_RATIO * length_m / np.sqrt(3) * rng.normal(size=3)
    return Pose(turn @ first_from_camera.rotation, first_from_camera.translation + step_m)
