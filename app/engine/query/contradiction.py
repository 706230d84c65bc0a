"""What speaks against a pose: parts of the picture where the map has features, the picture too, and none agree.

A wall of the same bricks elsewhere agrees in the bricks, but not in what hangs on it. A thing in front of the camera
contradicts as well, so that only a large share of the picture counts.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from app.engine.maps.artifact import MapArtifact
from app.engine.query.accuracy import seen_from_one_side
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.vision.matching import to_unit_vectors

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Chosen on right poses in RedKitchen, freiburg1_rpy and the demonstration and on wrong ones with a floor of it out of
# the map (docs/features.md).
GRID = (12, 9)
KEYFRAMES = 8
# A feature is expected when the pose sees it from nearly the keyframe's direction and distance.
MIN_COSINE, MIN_RATIO, MAX_RATIO = 0.9, 0.6, 1.6
# A cell with so many expected features, and so many of the picture's own, says something ...
MIN_EXPECTED, MIN_FEATURES = 10, 4
# ... against the pose when no more than this share of either is found in the other,
MAX_EXPLAINED = 0.1
# within this share of the picture's longer side, as one of the nearest features, and with descriptors this near: unit
# vectors, binary ones of +1 and -1.
RADIUS_SHARE, NEIGHBOURS, MAX_DISTANCE, MAX_DISTANCE_BINARY = 5.0 / 640.0, 6, 0.75, 1.0


def contradicted_share(
    artifact: MapArtifact,
    keyframes: list[int],
    world_from_camera: Pose,
    camera: Camera,
    features: tuple[Array, NDArray[np.float32]],
    inliers_px: Array,
    binary: bool,
) -> float:
    """Return the share of contradicting cells among those that contradict or hold inliers, on a 12 x 9 grid.

    `keyframes` are those that see what the pose sees; `features` the pixels (n, 2) and unit descriptors (n, d) of the
    picture's features; `inliers_px` (m, 2) those that agree with the pose.
    """
    points_px, unit = features
    size_px = np.array([camera.width, camera.height])
    supported = _count(_cells(inliers_px, size_px)) > 0
    rows, expected_px = _expected(artifact, keyframes, world_from_camera, camera)
    cells, own_cells = _cells(expected_px, size_px), _cells(points_px, size_px)
    expected, own = _count(cells), _count(own_cells)
    doubtful = (expected >= MIN_EXPECTED) & (own >= MIN_FEATURES) & ~supported
    if not doubtful.any():
        return 0.0
    asked = doubtful[cells]
    theirs = to_unit_vectors(artifact.arrays.descriptors[rows[asked]], binary)
    found, used = _explained(expected_px[asked], theirs, points_px, unit, camera, binary)
    explained, own_explained = _count(cells[asked][found]), _count(own_cells[used])
    against = doubtful & (explained <= MAX_EXPLAINED * expected) & (own_explained <= MAX_EXPLAINED * own)
    return float(against.sum() / (against.sum() + supported.sum()))


def _expected(
    artifact: MapArtifact, keyframes: list[int], world_from_camera: Pose, camera: Camera
) -> tuple[NDArray[np.intp], Array]:
    """Return the rows (n,) of the map's features that the pose should show, and their pixels (n, 2)."""
    if not keyframes:
        return np.zeros(0, np.intp), np.zeros((0, 2))
    slices = [artifact.rows(keyframe) for keyframe in keyframes]
    rows = np.concatenate([np.arange(each.start, each.stop) for each in slices])
    centres = np.repeat(
        artifact.arrays.positions[keyframes], [each.stop - each.start for each in slices], axis=0
    )
    points = artifact.arrays.points_in_world[rows].astype(np.float64)
    mapped_m = np.linalg.norm(points - centres, axis=1)
    seen_m = np.linalg.norm(points - world_from_camera.translation, axis=1)
    alike = seen_from_one_side(points, centres, world_from_camera.translation, MIN_COSINE)
    alike &= (seen_m > MIN_RATIO * mapped_m) & (seen_m < MAX_RATIO * mapped_m)
    pixels = camera.project(world_from_camera.inverse().apply(points[alike]))
    inside = camera.contains(pixels)
    return rows[alike][inside], pixels[inside]


def _explained(
    expected_px: Array,
    expected: NDArray[np.float32],
    points_px: Array,
    unit: NDArray[np.float32],
    camera: Camera,
    binary: bool,
) -> tuple[Mask, Mask]:
    """Return which expected features are found in the picture, and which of the picture's are found in them."""
    radius = RADIUS_SHARE * max(camera.width, camera.height)
    distances, near = cKDTree(points_px).query(expected_px, NEIGHBOURS, distance_upper_bound=radius)
    owner, slot = np.nonzero(np.isfinite(distances))
    rows = np.asarray(near)[owner, slot]
    squared = 2.0 - 2.0 * np.einsum("ij,ij->i", expected[owner], unit[rows])
    same = squared < (MAX_DISTANCE_BINARY if binary else MAX_DISTANCE) ** 2
    found, used = np.zeros(len(expected_px), bool), np.zeros(len(points_px), bool)
    found[owner[same]] = True
    used[rows[same]] = True
    return found, used


def _cells(points_px: Array, size_px: NDArray[np.int_]) -> NDArray[np.intp]:
    cells = np.clip(np.floor(points_px / size_px * GRID), 0, np.array(GRID) - 1).astype(np.intp)
    return np.asarray(cells[:, 0] * GRID[1] + cells[:, 1])


def _count(cells: NDArray[np.intp]) -> NDArray[np.intp]:
    return np.bincount(cells, minlength=GRID[0] * GRID[1])
