"""Matching with the map where a pose says its points should be: no retrieval, no global descriptor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from app.engine.maps.artifact import MapArtifact
from app.engine.query.matches import Matches
from app.geometry.camera import Camera
from app.geometry.reprojection import project_from_world
from app.geometry.se3 import Pose
from app.limits import limit
from app.vision.features import LocalFeatureExtractor, LocalFeatures
from app.vision.matching import to_unit_vectors


@dataclass(frozen=True, slots=True, kw_only=True)
class GuidedOptions:
    """When a feature near a projected map point is that point."""

    neighbours: int = limit(
        8,
        "Features nearest to a projected point that are compared with it.",
        chosen="roomfix simulate and track; docs/sessions.md.",
    )
    min_similarity: float = limit(
        0.75,
        "Least scalar product of the unit descriptors of one point seen twice.",
        chosen="roomfix simulate and track; docs/sessions.md.",
    )
    max_ratio: float = limit(
        0.9,
        "Threshold of the ratio test; weaker than for whole images, since the place excludes most look-alikes.",
        chosen="roomfix simulate and track; docs/sessions.md.",
    )


OPTIONS = GuidedOptions()


def match_near_projections(
    features: LocalFeatures,
    extractor: LocalFeatureExtractor,
    artifact: MapArtifact,
    keyframes: Sequence[int],
    camera: Camera,
    world_from_camera: Pose,
    radius_px: float,
) -> Matches:
    """Match features of an image with map points of keyframes that a pose projects within `radius_px` of them.

    Of each feature the most similar point counts. `camera` is the one of the features' pixels.
    """
    rows = artifact.rows_of(keyframes)
    arrays = artifact.arrays
    projected = project_from_world(arrays.points_in_world[rows], camera, world_from_camera)
    seen = camera.contains(projected)
    rows, projected = rows[seen], projected[seen]
    if len(rows) == 0 or len(features) < 2:
        return Matches.none()
    best, similarity, distinct = _most_similar(features, extractor, artifact, rows, projected, radius_px)
    good = np.flatnonzero(distinct & (similarity > OPTIONS.min_similarity))
    # Best first; of each feature the first, that is the most similar, stays.
    good = good[np.argsort(-similarity[good])]
    chosen, first = np.unique(best[good], return_index=True)
    points = rows[good[first]]
    owners = np.searchsorted(arrays.offsets, points, side="right") - 1
    return Matches(
        points_px=features.keypoints_px[chosen].astype(np.float64),
        points_in_world=arrays.points_in_world[points].astype(np.float64),
        sigma_m=arrays.point_sigma_m[points].astype(np.float64),
        query_rows=chosen.astype(np.intp),
        keyframes=owners.astype(np.intp),
        distances=np.sqrt(np.maximum(2.0 - 2.0 * similarity[good[first]], 0.0)),
        distinct=np.ones(len(chosen), dtype=bool),
    )


def _most_similar(
    features: LocalFeatures,
    extractor: LocalFeatureExtractor,
    artifact: MapArtifact,
    rows: NDArray[np.intp],
    projected: NDArray[np.float64],
    radius_px: float,
) -> tuple[NDArray[np.intp], NDArray[np.float32], NDArray[np.bool_]]:
    """Return, per map point (m,), its most similar feature, how similar, and whether no other comes close."""
    tree = cKDTree(features.keypoints_px)
    _, found = tree.query(projected, k=OPTIONS.neighbours, distance_upper_bound=radius_px)
    near = np.asarray(found)
    missing = near == len(features)
    unit = to_unit_vectors(features.descriptors, extractor.binary)
    theirs = to_unit_vectors(artifact.arrays.descriptors[rows], extractor.binary)
    some = ~missing[:, 0]
    similarity = np.full(near.shape, -1.0, np.float32)
    gathered = unit[np.where(missing[some], 0, near[some])]
    similarity[some] = np.einsum("mkd,md->mk", gathered, theirs[some])
    similarity[missing] = -1.0
    order = np.argsort(-similarity, axis=1)[:, :2]
    top = np.take_along_axis(similarity, order, axis=1)
    best = np.take_along_axis(near, order[:, :1], axis=1)[:, 0]
    distances = np.sqrt(np.maximum(2.0 - 2.0 * top, 0.0))
    distinct = some & (distances[:, 0] < OPTIONS.max_ratio * distances[:, 1])
    return best.astype(np.intp), top[:, 0], np.asarray(distinct)
