"""Whether a pose can be trusted: what speaks for it, the limits it must pass, and how sure that makes us."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Reason = Literal["no_match", "too_few_inliers", "ambiguous", "outside_venue", "poor_image", "no_map"]

GRID = (8, 6)


@dataclass(frozen=True, slots=True)
class Evidence:
    """What speaks for and against a pose.

    `inliers` and `matches` count features of the query, each once however many keyframes it was matched in.
    `coverage` is the share of an 8 x 6 grid over the image that holds inliers; `distinct` the inliers that
    resemble nothing elsewhere in the map; `rival` the inliers of the best
    other pose, `rival_only` those that the pose doesn't explain, `pose_only` the inliers that the rival doesn't;
    `keyframe_distance_m` how far the nearest keyframe is.
    """

    matches: int
    inliers: int
    coverage: float
    distinct: int
    rival: int
    rival_only: int
    pose_only: int
    keyframe_distance_m: float

    @property
    def inlier_ratio(self) -> float:
        """Inliers over matches."""
        return self.inliers / self.matches if self.matches else 0.0

    @property
    def distinct_share(self) -> float:
        """Distinct inliers over inliers."""
        return self.distinct / self.inliers if self.inliers else 0.0

    @staticmethod
    def none(matches: int = 0) -> Evidence:
        """Return the evidence for no pose at all."""
        return Evidence(matches, 0, 0.0, 0, 0, 0, 0, float("inf"))


@dataclass(frozen=True, slots=True)
class Limits:
    """What a pose must pass; measured on places that are in the map and on places that are not
    (docs/features.md)."""

    min_inliers: int = 16
    min_inlier_ratio: float = 0.10
    min_coverage: float = 0.15
    min_distinct_share: float = 0.2
    max_rival_share: float = 0.45
    max_position_sigma_m: float = 0.25
    max_keyframe_distance_m: float = 12.0

    @staticmethod
    def none() -> Limits:
        """Return limits that let every pose pass."""
        return Limits(0, 0.0, 0.0, 0.0, 1.0, float("inf"), float("inf"))


def gather_evidence(
    matched_rows: NDArray[np.intp],
    inlier_rows: NDArray[np.intp],
    inlier_px: NDArray[np.float64],
    distinct: int,
    rival_rows: NDArray[np.intp],
    size_px: tuple[int, int],
    keyframe_distance_m: float,
) -> Evidence:
    """Return the evidence from the rows of the query's features that were matched (m,), agree (n,), and agree
    with a rival (r,), the pixels (n, 2) of those that agree, in an image of `size_px` (width, height), and how
    many of them are distinct."""
    return Evidence(
        len(np.unique(matched_rows)),
        len(np.unique(inlier_rows)),
        coverage(inlier_px, size_px),
        distinct,
        len(np.unique(rival_rows)),
        len(np.setdiff1d(rival_rows, inlier_rows)),
        len(np.setdiff1d(inlier_rows, rival_rows)),
        keyframe_distance_m,
    )


def coverage(points_px: NDArray[np.float64], size_px: tuple[int, int]) -> float:
    """Return the share of the cells of an 8 x 6 grid over an image (width, height) that hold points (n, 2)."""
    cells = np.floor(points_px / np.array(size_px) * GRID).astype(int)
    cells = np.clip(cells, 0, np.array(GRID) - 1)
    return len(np.unique(cells[:, 0] * GRID[1] + cells[:, 1])) / (GRID[0] * GRID[1])


def judge(evidence: Evidence, position_sigma_m: float, limits: Limits) -> Reason | None:
    """Return why a pose can't be trusted, or None if it can."""
    if evidence.matches < limits.min_inliers:
        return "no_match"
    if evidence.inliers < limits.min_inliers or evidence.inlier_ratio < limits.min_inlier_ratio:
        return "too_few_inliers"
    if evidence.coverage < limits.min_coverage or position_sigma_m > limits.max_position_sigma_m:
        return "too_few_inliers"
    not_distinct = evidence.distinct_share < limits.min_distinct_share
    if not_distinct or evidence.rival > limits.max_rival_share * evidence.inliers:
        return "ambiguous"
    if evidence.keyframe_distance_m > limits.max_keyframe_distance_m:
        return "outside_venue"
    return None


def confidence_of(evidence: Evidence) -> float:
    """Return the probability that a pose with this evidence is off by less than 0.5 m and 5 degrees."""
    score = 1.8 * np.log(max(evidence.inliers, 1)) + 2.0 * evidence.inlier_ratio - 3.5
    return float(1.0 / (1.0 + np.exp(-score)))
