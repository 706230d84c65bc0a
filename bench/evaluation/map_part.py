"""A part of a map as a map of its own, as if the rest had never been scanned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.artifact import MapArtifact
from app.engine.maps.repetition import elsewhere
from app.vision.features import LocalFeatureExtractor
from app.vision.index import GlobalIndex


def part_of_map(
    artifact: MapArtifact, index: GlobalIndex, keyframes: NDArray[np.int64], extractor: LocalFeatureExtractor
) -> tuple[MapArtifact, GlobalIndex]:
    """Return the map of some of a map's keyframes, and its index.

    What looks like something elsewhere is computed again: a build of these keyframes alone has no others.
    `extractor` is the one of the map's features.
    """
    arrays = artifact.arrays
    slices = [artifact.rows(int(keyframe)) for keyframe in keyframes]
    rows = np.concatenate([np.arange(rows.start, rows.stop) for rows in slices])
    offsets = np.cumsum([0, *(rows.stop - rows.start for rows in slices)]).astype(np.int64)
    points, descriptors = arrays.points_in_world[rows], arrays.descriptors[rows]
    poses = [artifact.pose(int(keyframe)) for keyframe in keyframes]
    z_up = artifact.metadata.z_up
    distances, others = elsewhere(descriptors, extractor.binary, points, offsets, poses, z_up)
    part = replace(
        arrays,
        positions=arrays.positions[keyframes],
        quaternions=arrays.quaternions[keyframes],
        camera_rows=arrays.camera_rows[keyframes],
        offsets=offsets,
        keypoints_px=arrays.keypoints_px[rows],
        points_in_world=points,
        point_sigma_m=arrays.point_sigma_m[rows],
        distance_elsewhere=distances,
        keyframe_elsewhere=others,
        descriptors=descriptors,
    )
    names = tuple(artifact.metadata.keyframe_names[int(keyframe)] for keyframe in keyframes)
    return (
        MapArtifact(
            metadata=replace(artifact.metadata, keyframe_names=names),
            arrays=part,
            second=None if artifact.second is None else artifact.second.take(keyframes.tolist()),
        ),
        GlobalIndex.from_descriptors(index.descriptors[keyframes]),
    )
