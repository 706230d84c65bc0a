"""The matches that agree with a pose, as pixels of the query and of the keyframe that shares most of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.artifact import MapArtifact
from app.engine.query.matches import Matches


@dataclass(frozen=True, slots=True)
class ShownMatches:
    """A keyframe, and pixels (n, 2) of the query and (n, 2) of the keyframe that show the same points."""

    keyframe: int
    query_px: NDArray[np.float64]
    keyframe_px: NDArray[np.float64]


def shown_matches(artifact: MapArtifact, inliers: Matches) -> ShownMatches | None:
    """Return the inliers with the keyframe that has most of them; None without any.

    The keyframe's pixels are the projections of the matched points, which its features were unprojected to.
    """
    if len(inliers) == 0:
        return None
    ids, counts = np.unique(inliers.keyframes, return_counts=True)
    keyframe = int(ids[counts.argmax()])
    mine = inliers.keyframes == keyframe
    in_camera = artifact.pose(keyframe).inverse().apply(inliers.points_in_world[mine])
    return ShownMatches(keyframe, inliers.points_px[mine], artifact.camera(keyframe).project(in_camera))
