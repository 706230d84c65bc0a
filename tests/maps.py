"""Maps made of numbers, for tests of what is asked of a map alone."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.artifact import MapArrays, MapArtifact, MapMetadata
from app.geometry.se3 import Pose
from tests.scenes import CAMERA

Array = NDArray[np.float64]


def map_of(
    poses: Sequence[Pose],
    points: Sequence[Array],
    descriptors: Sequence[NDArray[np.uint8]],
    distance_elsewhere: Sequence[Array] | None = None,
    keyframe_elsewhere: Sequence[NDArray[np.int32]] | None = None,
) -> MapArtifact:
    """Return a map whose keyframe i, at `world_from_camera` poses[i], sees points[i] (n, 3) with descriptors[i]
    (n, d)."""
    counts = [len(each) for each in points]
    total = sum(counts)
    pixels = [CAMERA.project(pose.inverse().apply(each)) for pose, each in zip(poses, points, strict=True)]
    arrays = MapArrays(
        positions=np.stack([pose.translation for pose in poses]),
        quaternions=np.stack([pose.quaternion for pose in poses]),
        camera_rows=np.zeros(len(poses), np.int32),
        offsets=np.cumsum([0, *counts]).astype(np.int64),
        keypoints_px=np.concatenate(pixels).astype(np.float32),
        points_in_world=np.concatenate(points).astype(np.float32),
        point_sigma_m=np.full(total, 0.01, np.float32),
        distance_elsewhere=np.full(total, np.inf, np.float16)
        if distance_elsewhere is None
        else np.concatenate(distance_elsewhere).astype(np.float16),
        keyframe_elsewhere=np.full(total, -1, np.int32)
        if keyframe_elsewhere is None
        else np.concatenate(keyframe_elsewhere),
        descriptors=np.concatenate(descriptors),
    )
    names = tuple(f"{i}.png" for i in range(len(poses)))
    return MapArtifact(
        metadata=MapMetadata(
            features="sift", descriptor_sha256="", descriptor_size=8, cameras=(CAMERA,), keyframe_names=names
        ),
        arrays=arrays,
    )


def write_without_checksums(artifact: MapArtifact, path: Path) -> None:
    """Write a map in the form before the present one, `RFMAP002`."""
    arrays = {name: np.asarray(getattr(artifact.arrays, name)) for name in MapArrays.__slots__}
    table, offset = {}, 0
    for name, array in arrays.items():
        table[name] = {"dtype": array.dtype.str, "shape": list(array.shape), "offset": offset}
        offset = -(-(offset + array.nbytes) // 64) * 64
    text = json.dumps({"metadata": asdict(artifact.metadata), "arrays": table}).encode()
    start = -(-(16 + len(text)) // 64) * 64
    data = bytearray(start + offset)
    data[: 16 + len(text)] = b"RFMAP002" + len(text).to_bytes(8, "little") + text
    for name, array in arrays.items():
        first = start + int(table[name]["offset"])
        data[first : first + array.nbytes] = array.tobytes()
    path.write_bytes(bytes(data))
