"""Whether a picture looks, where a pose says that the map's features are, as the map saw them.

A match needs a feature of the picture at the same spot. A learned descriptor can be read at any pixel: each feature of
the map that a pose expects in the picture is compared with what is there. A right pose agrees all over the picture; one
from what looks alike elsewhere agrees in its inliers and hardly beside them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.artifact import MapArtifact
from app.engine.maps.open_map import OpenMap
from app.engine.maps.second_features import SecondFeatures
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.limits import limit
from app.vision.dense_descriptors import DenseDescriptors

Array = NDArray[np.float64]

# Columns and rows of the grid whose cells agree with a pose or not.
GRID = (8, 6)
FITTED = "By hand, on right and wrong candidates of a second look in desk_rs; docs/figures/unseen.md."


@dataclass(frozen=True, slots=True, kw_only=True)
class AgreementOptions:
    """What is expected in a picture, and when it is there."""

    keyframes: int = limit(
        8,
        "Keyframes whose features are expected in the picture.",
        chosen="By hand: as many as contradiction uses.",
    )
    min_cosine: float = limit(
        0.8,
        "A feature is expected when the pose sees it within this cosine of the keyframe's ray.",
        chosen="By hand: learned descriptors change little within 37 degrees.",
    )
    max_distance_ratio: float = limit(
        2.5,
        "A feature is expected when the camera is at most this many times nearer or farther than the keyframe.",
        chosen="By hand: the descriptors of features at other scales differ.",
    )
    min_similarity: float = limit(0.6, "Least cosine of two descriptors of one thing.", chosen=FITTED)
    max_better_share: float = limit(
        0.05,
        "A feature is there when at most this share of other places of the picture look more like it.",
        chosen=FITTED,
    )
    min_better_share: float = limit(
        0.2,
        "A feature is missing when more than this share of other places look more like it.",
        chosen=FITTED,
    )
    other_places: int = limit(
        200,
        "Places of the picture that are compared with a feature.",
        chosen="By hand: tells 5 % within 1.5 %.",
    )
    min_expected: int = limit(3, "Expected features of a cell that counts.", chosen=FITTED)
    agreeing_share: float = limit(
        0.5, "A cell agrees when more than this share of its expected features is there.", chosen=FITTED
    )
    disagreeing_share: float = limit(
        0.75,
        "A cell that does not agree disagrees when more than this share of its expected features is missing.",
        chosen=FITTED,
    )


OPTIONS = AgreementOptions()


@dataclass(frozen=True, slots=True)
class Agreement:
    """How many cells of a picture look as a pose says, and how many don't."""

    agreeing: int = 0
    disagreeing: int = 0

    @property
    def disagreeing_share(self) -> float:
        """The disagreeing cells among those that agree or disagree."""
        return self.disagreeing / (self.agreeing + self.disagreeing) if self.disagreeing else 0.0

    @property
    def balance(self) -> int:
        """How many cells more agree than disagree."""
        return self.agreeing - self.disagreeing


def agreement_in_map(
    opened: OpenMap,
    world_from_camera: Pose,
    camera: Camera,
    picture: DenseDescriptors,
    allowed: NDArray[np.int64] | None = None,
) -> Agreement:
    """Return the agreement of a picture with a pose, by the second features of the keyframes that see what the pose
    sees; `allowed` restricts them."""
    second = opened.artifact.second
    if second is None:
        return Agreement()
    points, descriptors = [np.zeros((0, 3))], [np.zeros((0, 64), np.float16)]
    for keyframe in opened.retrieval.covisible(world_from_camera, OPTIONS.keyframes, set(), allowed):
        rows = _expected(opened.artifact, second, keyframe, world_from_camera)
        points.append(second.points_in_world[rows].astype(np.float64))
        descriptors.append(second.descriptors[rows])
    in_camera = world_from_camera.inverse().apply(np.concatenate(points))
    with np.errstate(invalid="ignore", divide="ignore"):
        points_px = camera.project(in_camera)
    seen = (in_camera[:, 2] > 0) & np.isfinite(points_px).all(axis=1)
    seen[seen] = camera.contains(points_px[seen]) & picture.contains(points_px[seen])
    expected = np.concatenate(descriptors)[seen].astype(np.float32)
    there, missing = _compared(expected, points_px[seen], picture)
    return _count(points_px[seen], there, missing, (camera.width, camera.height))


def _compared(
    expected: NDArray[np.float32], points_px: Array, picture: DenseDescriptors
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which features (n,) of descriptors (n, 64) are there at points (n, 2) of a picture, and which are missing.

    A carpet looks alike everywhere: a feature is there when the picture looks more like it than nearly anywhere else.
    """
    similarity = np.einsum("nd,nd->n", expected, picture.at(points_px))
    better = (expected @ picture.sample(OPTIONS.other_places).T > similarity[:, None]).mean(axis=1)
    unlike = similarity < OPTIONS.min_similarity
    return ~unlike & (better <= OPTIONS.max_better_share), unlike | (better > OPTIONS.min_better_share)


def _expected(
    artifact: MapArtifact, second: SecondFeatures, keyframe: int, world_from_camera: Pose
) -> NDArray[np.intp]:
    """Return the rows (n,) of a keyframe's second features that a pose sees much as the keyframe saw them."""
    span = second.span(keyframe)
    points = second.points_in_world[span].astype(np.float64)
    a, b = points - artifact.arrays.positions[keyframe], points - world_from_camera.translation
    then_m, now_m = np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1)
    near = (now_m < OPTIONS.max_distance_ratio * then_m) & (then_m < OPTIONS.max_distance_ratio * now_m)
    aligned = np.einsum("ij,ij->i", a, b) > OPTIONS.min_cosine * then_m * now_m
    return np.asarray(span.start + np.flatnonzero(near & aligned))


def _count(
    points_px: Array, there: NDArray[np.bool_], missing: NDArray[np.bool_], size_px: tuple[int, int]
) -> Agreement:
    """Return the cells that agree and disagree by features (n, 2), and whether each is there or missing (n,)."""
    cells = np.clip(np.floor(points_px / np.array(size_px) * GRID).astype(int), 0, np.array(GRID) - 1)
    numbers = cells[:, 0] * GRID[1] + cells[:, 1]
    expected, found, lost = (
        np.bincount(numbers[chosen], minlength=GRID[0] * GRID[1])
        for chosen in (np.ones_like(there), there, missing)
    )
    counts = expected >= OPTIONS.min_expected
    agreeing = counts & (found > OPTIONS.agreeing_share * expected)
    disagreeing = counts & ~agreeing & (lost > OPTIONS.disagreeing_share * expected)
    return Agreement(int(agreeing.sum()), int(disagreeing.sum()))
