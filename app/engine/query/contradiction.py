"""What speaks against a pose: parts of the picture where the map has features, the picture too, and none agree.

A wall of the same bricks elsewhere agrees in the bricks, but not in what hangs on it. A thing in front of the camera
contradicts as well, so that only a large share of the picture counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from app.engine.maps.artifact import MapArtifact
from app.engine.maps.open_map import OpenMap
from app.engine.query.hypothesis import seen_from_one_side
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.limits import limit
from app.vision.matching import to_unit_vectors

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Columns and rows of the grid whose cells may contradict a pose.
GRID = (12, 9)
CHOSEN = (
    "On right poses in RedKitchen, freiburg1_rpy and the demonstration venue, and on wrong ones with a floor of it "
    "left out of the map; docs/features.md."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ContradictionOptions:
    """When a cell of the picture contradicts a pose."""

    keyframes: int = limit(8, "Keyframes whose features are expected in the picture.", chosen=CHOSEN)
    min_cosine: float = limit(
        0.9,
        "A feature is expected when the pose sees it within this cosine of the keyframe's ray.",
        chosen=CHOSEN,
    )
    min_distance_ratio: float = limit(
        0.6,
        "A feature is expected when it is at least this ratio of the keyframe's distance away.",
        chosen=CHOSEN,
    )
    max_distance_ratio: float = limit(
        1.6,
        "A feature is expected when it is at most this ratio of the keyframe's distance away.",
        chosen=CHOSEN,
    )
    min_expected: int = limit(10, "Expected features that a cell must have to contradict.", chosen=CHOSEN)
    min_features: int = limit(
        4, "Features of the picture that a cell must have to contradict.", chosen=CHOSEN
    )
    max_explained_share: float = limit(
        0.1,
        "A cell contradicts when at most this share of either's features is found in the other.",
        chosen=CHOSEN,
    )
    radius_share: float = limit(
        5.0 / 640.0,
        "A feature is searched for within this share of the picture's longer side.",
        chosen=CHOSEN,
    )
    neighbours: int = limit(
        6, "Nearest features of the picture that an expected one is compared with.", chosen=CHOSEN
    )
    max_distance: float = limit(0.75, "Largest distance of unit descriptors of one thing.", chosen=CHOSEN)
    max_distance_binary: float = limit(
        1.0, "Largest distance of binary descriptors (of +1 and -1, unit length) of one thing.", chosen=CHOSEN
    )


OPTIONS = ContradictionOptions()


@dataclass(frozen=True, slots=True)
class Cells:
    """How many cells of a picture contradict a pose, and how many hold inliers."""

    against: int
    supported: int

    @property
    def contradicted_share(self) -> float:
        """The contradicting cells among those that contradict or hold inliers."""
        return self.against / (self.against + self.supported) if self.against else 0.0


def contradicted_in_map(
    opened: OpenMap,
    world_from_camera: Pose,
    camera: Camera,
    features: tuple[Array, NDArray[np.float32]],
    inliers_px: Array,
    allowed: NDArray[np.int64] | None = None,
) -> float:
    """Return the share of contradicting cells by the keyframes that see what the pose sees; `allowed` restricts
    them."""
    return cells_in_map(opened, world_from_camera, camera, features, inliers_px, allowed).contradicted_share


def cells_in_map(
    opened: OpenMap,
    world_from_camera: Pose,
    camera: Camera,
    features: tuple[Array, NDArray[np.float32]],
    inliers_px: Array,
    allowed: NDArray[np.int64] | None = None,
) -> Cells:
    """Return the cells that speak for and against a pose, by the keyframes that see what it sees; `allowed` restricts
    them."""
    keyframes = opened.retrieval.covisible(world_from_camera, OPTIONS.keyframes, set(), allowed)
    binary = opened.extractor.binary
    return cells_of(opened.artifact, keyframes, world_from_camera, camera, features, inliers_px, binary)


def cells_of(
    artifact: MapArtifact,
    keyframes: list[int],
    world_from_camera: Pose,
    camera: Camera,
    features: tuple[Array, NDArray[np.float32]],
    inliers_px: Array,
    binary: bool,
) -> Cells:
    """Return the cells on a 12 x 9 grid.

    `keyframes` are those that see what the pose sees; `features` the pixels (n, 2) and unit descriptors (n, d) of the
    picture's features; `inliers_px` (m, 2) those that agree with the pose.
    """
    points_px, unit = features
    size_px = np.array([camera.width, camera.height])
    supported = _count(_cells(inliers_px, size_px)) > 0
    rows, expected_px = _expected(artifact, keyframes, world_from_camera, camera)
    cells, own_cells = _cells(expected_px, size_px), _cells(points_px, size_px)
    expected, own = _count(cells), _count(own_cells)
    doubtful = (expected >= OPTIONS.min_expected) & (own >= OPTIONS.min_features) & ~supported
    if not doubtful.any():
        return Cells(0, int(supported.sum()))
    asked = doubtful[cells]
    theirs = to_unit_vectors(artifact.arrays.descriptors[rows[asked]], binary)
    found, used = _explained(expected_px[asked], theirs, points_px, unit, camera, binary)
    explained, own_explained = _count(cells[asked][found]), _count(own_cells[used])
    share = OPTIONS.max_explained_share
    against = doubtful & (explained <= share * expected) & (own_explained <= share * own)
    return Cells(int(against.sum()), int(supported.sum()))


def _expected(
    artifact: MapArtifact, keyframes: list[int], world_from_camera: Pose, camera: Camera
) -> tuple[NDArray[np.intp], Array]:
    """Return the rows (n,) of the map's features that the pose should show, and their pixels (n, 2)."""
    if not keyframes:
        return np.zeros(0, np.intp), np.zeros((0, 2))
    rows = artifact.rows_of(keyframes)
    counts = np.diff(artifact.arrays.offsets)[keyframes]
    centres = np.repeat(artifact.arrays.positions[keyframes], counts, axis=0)
    points = artifact.arrays.points_in_world[rows].astype(np.float64)
    mapped_m = np.linalg.norm(points - centres, axis=1)
    seen_m = np.linalg.norm(points - world_from_camera.translation, axis=1)
    alike = seen_from_one_side(points, centres, world_from_camera.translation, OPTIONS.min_cosine)
    alike &= (seen_m > OPTIONS.min_distance_ratio * mapped_m) & (
        seen_m < OPTIONS.max_distance_ratio * mapped_m
    )
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
    radius = OPTIONS.radius_share * max(camera.width, camera.height)
    distances, near = cKDTree(points_px).query(expected_px, OPTIONS.neighbours, distance_upper_bound=radius)
    owner, slot = np.nonzero(np.isfinite(distances))
    rows = np.asarray(near)[owner, slot]
    squared = 2.0 - 2.0 * np.einsum("ij,ij->i", expected[owner], unit[rows])
    same = squared < (OPTIONS.max_distance_binary if binary else OPTIONS.max_distance) ** 2
    found, used = np.zeros(len(expected_px), bool), np.zeros(len(points_px), bool)
    found[owner[same]] = True
    used[rows[same]] = True
    return found, used


def _cells(points_px: Array, size_px: NDArray[np.int_]) -> NDArray[np.intp]:
    cells = np.clip(np.floor(points_px / size_px * GRID), 0, np.array(GRID) - 1).astype(np.intp)
    return np.asarray(cells[:, 0] * GRID[1] + cells[:, 1])


def _count(cells: NDArray[np.intp]) -> NDArray[np.intp]:
    return np.bincount(cells, minlength=GRID[0] * GRID[1])
