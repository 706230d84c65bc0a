"""Features of supporting frames, those between the keyframes, that are added to the nearest keyframe.

A detector does not find every feature in every image. A supporting frame has features that its keyframe lacks, and a
query finds those as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.points import MIN_AXES_COSINE, MapPoints, scaled_px
from app.engine.maps.points import OPTIONS as POINT_OPTIONS
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.limits import limit
from app.vision.features import LocalFeatures
from app.vision.matching import to_unit_vectors


@dataclass(frozen=True, slots=True, kw_only=True)
class SupportingFeatureOptions:
    """How many features a keyframe takes from supporting frames, and which of them it has already."""

    enough_features: int = limit(
        500,
        "Number of features of a keyframe up to which features of supporting frames are added.",
        chosen="By hand; no measurement is recorded.",
    )
    same_feature_px: float = limit(
        10.0,
        "Largest distance in u and in v, at 640 pixels of width, of two features that can be the same.",
        chosen="By hand: the same feature twice in a keyframe would make both fail the ratio test.",
    )
    same_feature_similarity: float = limit(
        0.75,
        "Least scalar product of the unit descriptors of two features that can be the same.",
        chosen="By hand: the same feature twice in a keyframe would make both fail the ratio test.",
    )
    axes_weight_m: float = limit(
        2.0,
        "Distance that counts as much as 1 minus the cosine of the optical axes' angle, for the nearest keyframe.",
        chosen="By hand; no measurement is recorded.",
    )


OPTIONS = SupportingFeatureOptions()


def nearest_keyframe(frame: Pose, keyframe_poses: Sequence[Pose]) -> int | None:
    """Return the row of the keyframe nearest to a frame's pose, None where all are too far or look elsewhere."""
    distances = np.linalg.norm(np.stack([k.translation for k in keyframe_poses]) - frame.translation, axis=1)
    cosines = np.stack([k.rotation[:, 2] for k in keyframe_poses]) @ frame.rotation[:, 2]
    cost = distances + OPTIONS.axes_weight_m * (1.0 - cosines)
    cost[(distances > POINT_OPTIONS.max_baseline_m) | (cosines < MIN_AXES_COSINE)] = np.inf
    best = int(np.argmin(cost))
    return best if np.isfinite(cost[best]) else None


def with_supporting_features(
    own: MapPoints, others: Sequence[MapPoints], world_from_camera: Pose, camera: Camera, binary: bool
) -> MapPoints:
    """Return a keyframe's points and those of other frames that it lacks, up to `OPTIONS.enough_features` in all.

    An added feature gets the pixel of its point's projection into the keyframe. The points with the smallest standard
    deviation are added first.
    """
    room = OPTIONS.enough_features - len(own.features)
    if room <= 0 or not others:
        return own
    offered = MapPoints.merge([_inside(other, world_from_camera, camera) for other in others])
    offered = offered.take(np.argsort(offered.sigma_m, kind="stable"))
    radius_px = scaled_px(OPTIONS.same_feature_px, camera)
    known = np.any(_same(offered.features, own.features, radius_px, binary), axis=1)
    offered = offered.take(np.flatnonzero(~known))
    chosen = _unlike(_same(offered.features, offered.features, radius_px, binary))
    return MapPoints.merge([own, offered.take(chosen[:room])])


def _inside(points: MapPoints, world_from_camera: Pose, camera: Camera) -> MapPoints:
    """Return the points that project into a camera's image, at the pixels of their projections."""
    pixels = camera.project(world_from_camera.inverse().apply(points.points_in_world))
    inside = camera.contains(pixels)
    kept = points.take(inside)
    return replace(kept, features=LocalFeatures(pixels[inside].astype(np.float32), kept.features.descriptors))


def _same(a: LocalFeatures, b: LocalFeatures, radius_px: float, binary: bool) -> NDArray[np.bool_]:
    """Return whether a feature of `a` (n,) and one of `b` (m,) are the same, (n, m)."""
    alike = (
        to_unit_vectors(a.descriptors, binary) @ to_unit_vectors(b.descriptors, binary).T
        > OPTIONS.same_feature_similarity
    )
    offsets = np.abs(a.keypoints_px[:, None] - b.keypoints_px[None])
    return np.asarray(alike & (offsets.max(axis=2) < radius_px))


def _unlike(same: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the rows that are not the same (n, n) as an earlier row that is returned."""
    dropped, chosen = np.zeros(len(same), dtype=bool), []
    for row in range(len(same)):
        if not dropped[row]:
            chosen.append(row)
            dropped |= same[row]
    return np.array(chosen, dtype=np.intp)
