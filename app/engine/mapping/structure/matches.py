"""Features of the pictures, which pictures are compared, and the matches that a fundamental matrix verifies."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.frame_images import frame_rgb
from app.engine.mapping.structure.chosen import ChosenPictures
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import Progress, map_in_order
from app.geometry.camera import tangent_of_px
from app.geometry.epipolar import filter_by_fundamental_matrix
from app.importers.frames import Frame
from app.limits import limit
from app.vision.features import LocalFeatureExtractor, LocalFeatures
from app.vision.images import Gray, to_gray
from app.vision.local_features import create_wall_extractor
from app.vision.matching import match_unit_vectors, to_unit_vectors

Rows = NDArray[np.intp]
Pair = tuple[int, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchOptions:
    """Which pictures are compared, and which of their matches are kept."""

    features: str = limit(
        "sift-full", "Local features of the reconstruction.", chosen="By hand: more exact than those of maps."
    )
    few_features: int = limit(
        1000,
        "A picture of a long sequence with fewer features is searched again for faint ones.",
        chosen="By hand, on the video of `roomfix evaluate-video`: from each picture to the next 149 features or more "
        "then match, also at plain walls.",
    )
    long_sequence: int = limit(
        80,
        "Pictures of a sequence that is not long yet.",
        chosen="By hand: a shorter one is reconstructed picture by picture, which faint features bend.",
    )
    ratio: float = limit(
        0.8,
        "Largest distance of the best match over that of the second best.",
        chosen="By hand: Lowe's ratio.",
    )
    neighbours: int = limit(
        8,
        "Pictures after each one of a sequence that it is compared with.",
        chosen="By hand: further ones share less than half of the view.",
    )
    doubling_steps: int = limit(
        4,
        "Further pictures of a sequence at twice the distance each time.",
        chosen="By hand: they tie a slow sweep together.",
    )
    retrieved: int = limit(
        8,
        "Most similar other pictures, by the global descriptor, that each one is compared with.",
        chosen="By hand: where a walk comes back to a place, several frames see it.",
    )
    all_pairs_up_to: int = limit(
        40,
        "With this number of pictures or fewer, all are compared.",
        chosen="By hand: 780 pairs take seconds.",
    )
    max_error_px: float = limit(
        3.0,
        "Largest distance of a match from its epipolar line, at the focal length of reference.",
        chosen="By hand: allows for the distortion that is not known yet.",
    )
    min_matches: int = limit(
        20,
        "Verified matches that tie two pictures together.",
        chosen="By hand: pictures of other places reach 8 (docs/features.md), and look-alike corners some more.",
    )


OPTIONS = MatchOptions()


@dataclass(frozen=True, slots=True)
class MatchedPictures:
    """The features of each picture, and rows (n, 2) of the matched features of pairs of pictures (i < j)."""

    features: tuple[LocalFeatures, ...]
    matches: dict[Pair, Rows]


def match_pictures(
    chosen: ChosenPictures, models: VisionModels, executor: Executor, progress: Progress
) -> MatchedPictures:
    """Return the verified matches of the pictures."""
    scan, extractor = chosen.scan, models.extractor(OPTIONS.features)
    is_long = chosen.is_sequence and len(scan.frames) > OPTIONS.long_sequence

    def describe(frame: Frame) -> tuple[LocalFeatures, NDArray[np.float32]]:
        rgb = frame_rgb(scan, frame)
        found = features_of(to_gray(rgb), extractor, is_long=is_long)
        return found, models.global_descriptor.describe(rgb)

    described = list(map_in_order(executor, describe, scan.frames, "find_features", progress))
    features = tuple(own for own, _ in described)
    unit = [to_unit_vectors(own.descriptors, extractor.binary) for own in features]
    max_error_px = tangent_of_px(OPTIONS.max_error_px) * scan.camera.focal_px
    partners: dict[int, list[int]] = defaultdict(list)
    for i, j in pairs_to_compare(np.stack([vector for _, vector in described]), chosen.is_sequence):
        partners[i].append(j)

    def match(i: int) -> dict[Pair, Rows]:
        found = {}
        for j in partners[i]:
            a, b, _ = match_unit_vectors(unit[i], unit[j], OPTIONS.ratio, extractor.binary)
            if len(a) < OPTIONS.min_matches:
                continue
            good = filter_by_fundamental_matrix(
                features[i].keypoints_px[a], features[j].keypoints_px[b], max_error_px=max_error_px
            )
            if good.sum() >= OPTIONS.min_matches:
                found[i, j] = np.stack([a[good], b[good]], axis=1)
        return found

    matched = map_in_order(executor, match, sorted(partners), "match_frames", progress)
    return MatchedPictures(features, {pair: rows for found in matched for pair, rows in found.items()})


def features_of(gray: Gray, extractor: LocalFeatureExtractor, *, is_long: bool) -> LocalFeatures:
    """Return the features of a picture, in a long sequence those of plain walls too."""
    found = extractor.extract(gray)
    if is_long and len(found) < OPTIONS.few_features:
        return create_wall_extractor().extract(gray)
    return found


def pairs_to_compare(descriptors: NDArray[np.float32], is_sequence: bool) -> list[Pair]:
    """Return the pairs (i < j) of pictures with global descriptors (n, d) that are compared."""
    count = len(descriptors)
    if count <= OPTIONS.all_pairs_up_to:
        return [(i, j) for i in range(count) for j in range(i + 1, count)]
    pairs = {_ordered(i, j) for i, row in enumerate(_most_similar(descriptors, is_sequence)) for j in row}
    if is_sequence:
        doubled = [OPTIONS.neighbours * 2**k for k in range(1, OPTIONS.doubling_steps + 1)]
        steps: Iterable[int] = [*range(1, OPTIONS.neighbours + 1), *doubled]
        pairs |= {(i, i + step) for step in steps for i in range(count - step)}
    return sorted(pairs)


def _ordered(i: int, j: int) -> Pair:
    return (i, j) if i < j else (j, i)


def _most_similar(descriptors: NDArray[np.float32], is_sequence: bool) -> Sequence[Rows]:
    """Return for each picture the rows of the most similar ones, neighbours in a sequence left out."""
    similarity = descriptors @ descriptors.T
    rows = np.arange(len(descriptors))
    near = np.abs(rows[:, None] - rows) <= (OPTIONS.neighbours if is_sequence else 0)
    similarity[near] = -np.inf
    best = np.argsort(-similarity, axis=1)[:, : OPTIONS.retrieved if is_sequence else 3 * OPTIONS.retrieved]
    return [row[np.isfinite(similarity[i, row])] for i, row in enumerate(best)]
