"""What the frames that did not become keyframes saw and the keyframes did not: features that keyframes take over.

No detector finds every feature in every picture. Of the frames that a keyframe stands for each finds some that the
keyframe has missed, and a query finds those as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.points import MAX_BASELINE_M, MIN_AXES_COSINE, MapPoints
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.vision.features import LocalFeatures
from app.vision.matching import to_unit_vectors

# A keyframe with this many features takes no more.
ENOUGH_FEATURES = 500
# Features of two frames are the same when they lie this near in a picture of 640 pixels and look this alike (scalar
# product of unit vectors): both in a keyframe would make each other's matches ambiguous.
SAME_PX, SAME_SIMILARITY = 10.0, 0.75
# One unit of 1 - cosine between two views separates them as much as so many metres.
AXES_WEIGHT_M = 2.0


def nearest_keyframe(frame: Pose, keyframes: Sequence[Pose]) -> int | None:
    """Return the keyframe that sees most of what a frame sees, None when none of them sees any."""
    distances = np.linalg.norm(np.stack([k.translation for k in keyframes]) - frame.translation, axis=1)
    cosines = np.stack([k.rotation[:, 2] for k in keyframes]) @ frame.rotation[:, 2]
    cost = distances + AXES_WEIGHT_M * (1.0 - cosines)
    cost[(distances > MAX_BASELINE_M) | (cosines < MIN_AXES_COSINE)] = np.inf
    best = int(np.argmin(cost))
    return best if np.isfinite(cost[best]) else None


def with_supporting_features(
    own: MapPoints, others: Sequence[MapPoints], world_from_camera: Pose, camera: Camera, binary: bool
) -> MapPoints:
    """Return a keyframe's points and, up to `ENOUGH_FEATURES` in all, those of other frames that it has none of.

    They get the pixel at which the keyframe would see them. Those known best come first.
    """
    room = ENOUGH_FEATURES - len(own.features)
    if room <= 0 or not others:
        return own
    offered = MapPoints.merge([_inside(other, world_from_camera, camera) for other in others])
    offered = offered.take(np.argsort(offered.sigma_m, kind="stable"))
    radius = SAME_PX * max(camera.width, camera.height) / 640.0
    known = np.any(_same(offered.features, own.features, radius, binary), axis=1)
    offered = offered.take(np.flatnonzero(~known))
    chosen = _unlike(_same(offered.features, offered.features, radius, binary))
    return MapPoints.merge([own, offered.take(chosen[:room])])


def _inside(points: MapPoints, world_from_camera: Pose, camera: Camera) -> MapPoints:
    """Return the points that a camera has in its picture, at their pixels in it."""
    pixels = camera.project(world_from_camera.inverse().apply(points.points_in_world))
    inside = camera.contains(pixels)
    kept = points.take(inside)
    return replace(kept, features=LocalFeatures(pixels[inside].astype(np.float32), kept.features.descriptors))


def _same(a: LocalFeatures, b: LocalFeatures, radius_px: float, binary: bool) -> NDArray[np.bool_]:
    """Return which features of `a` (n,) and `b` (m,) are the same, (n, m)."""
    alike = (
        to_unit_vectors(a.descriptors, binary) @ to_unit_vectors(b.descriptors, binary).T > SAME_SIMILARITY
    )
    offsets = np.abs(a.keypoints_px[:, None] - b.keypoints_px[None])
    return np.asarray(alike & (offsets.max(axis=2) < radius_px))


def _unlike(same: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the rows, from the first on, that are not the same (n, n) as one before them that was taken."""
    dropped, chosen = np.zeros(len(same), dtype=bool), []
    for row in range(len(same)):
        if not dropped[row]:
            chosen.append(row)
            dropped |= same[row]
    return np.array(chosen, dtype=np.intp)
