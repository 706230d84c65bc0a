"""How many matches of a feature method are right, by the angle between two cameras (C section 4.1)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray

from app.geometry.camera import Camera, tangent_of_px
from app.geometry.epipolar import essential_from_pose, in_front_of_both
from app.geometry.sampson import sampson_errors
from app.geometry.se3 import Pose
from app.vision.features import LocalFeatureExtractor, LocalFeatures
from app.vision.images import Gray
from app.vision.local_features import create_extractor
from app.vision.matching import match_unit_vectors, to_unit_vectors

# A match is right when its distance to where the true poses put it is at most this angle (tangent).
RIGHT = tangent_of_px(3.0)


@dataclass(frozen=True, slots=True)
class MatchQuality:
    """One method's matches at one range of angles: share that is right, how many are right, extraction time."""

    features: str
    right_percent: float
    right: float
    extract_ms: float


def compared_methods() -> list[LocalFeatureExtractor]:
    """Return the thesis's four methods and XFeat; SURF only where mahotas is installed."""
    methods = [create_extractor(name) for name in ("sift-full", "orb", "akaze", "xfeat")]
    return [*methods, create_extractor("surf")] if find_spec("mahotas") is not None else methods


@dataclass(frozen=True, slots=True)
class PosedPictures:
    """Two grey pictures with their cameras and the true pose of the second from the first."""

    first: Gray
    second: Gray
    first_camera: Camera
    second_camera: Camera
    second_from_first: Pose


@dataclass(frozen=True, slots=True)
class MethodMatches:
    """One method's matches of two pictures: their pixels (n, 2) in each, and which are right (n,)."""

    first_px: NDArray[np.float32]
    second_px: NDArray[np.float32]
    right: NDArray[np.bool_]


def matches_of(method: LocalFeatureExtractor, pair: PosedPictures) -> MethodMatches:
    """Return the matches of two pictures."""
    return _matched(method, pair, method.extract(pair.first), method.extract(pair.second))


def match_quality(method: LocalFeatureExtractor, pictures: Sequence[PosedPictures]) -> MatchQuality:
    """Return how well a method matches pictures."""
    shares, counts, spent = [], [], 0.0
    for pair in pictures:
        started = time.perf_counter()
        a, b = method.extract(pair.first), method.extract(pair.second)
        spent += time.perf_counter() - started
        right = _matched(method, pair, a, b).right
        shares.append(float(right.mean()) if len(right) else 0.0)
        counts.append(int(right.sum()))
    return MatchQuality(
        method.name,
        round(100 * float(np.mean(shares)), 1),
        round(float(np.mean(counts)), 1),
        round(1e3 * spent / (2 * len(pictures)), 1),
    )


def _matched(
    method: LocalFeatureExtractor, pair: PosedPictures, a: LocalFeatures, b: LocalFeatures
) -> MethodMatches:
    units = to_unit_vectors(a.descriptors, method.binary), to_unit_vectors(b.descriptors, method.binary)
    rows, others, _ = match_unit_vectors(*units, method.ratio, method.binary)
    first_px, second_px = a.keypoints_px[rows], b.keypoints_px[others]
    return MethodMatches(first_px, second_px, _right(pair, first_px, second_px))


def _right(
    pair: PosedPictures, first_px: NDArray[np.float32], second_px: NDArray[np.float32]
) -> NDArray[np.bool_]:
    a, b = pair.first_camera.normalize(first_px), pair.second_camera.normalize(second_px)
    if len(a) == 0:
        return np.zeros(0, dtype=bool)
    near = sampson_errors(essential_from_pose(pair.second_from_first), a, b) < RIGHT
    return np.asarray(near & in_front_of_both(a, b, pair.second_from_first))
