"""Whether a pose can be trusted: what speaks for it, the limits it must pass, and how sure that makes us."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from app.engine.query.matches import Matches
from app.geometry.camera import Camera

Reason = Literal["no_match", "too_few_inliers", "ambiguous", "outside_venue", "poor_image", "no_map"]

GRID = (8, 6)


@dataclass(frozen=True, slots=True)
class Evidence:
    """What speaks for and against a pose.

    `inliers` and `matches` count features of the query, each once however many keyframes it was matched in.
    `coverage` is the share of an 8 x 6 grid over the image that holds inliers; `distinct` the inliers that
    resemble nothing elsewhere in the map; `rival` the inliers of the best other pose, `rival_only` those that the
    pose doesn't explain, `pose_only` the inliers that the rival doesn't; `keyframe_distance_m` how far the nearest
    keyframe is; `position_sigma_m` one sigma of the position by the geometry of the inliers; `unrepeated` the
    inliers on things of which no view resembles anything elsewhere (None: not counted); `contradicted` the share of
    the picture that speaks against the pose (`services.contradiction`).
    """

    matches: int
    inliers: int
    coverage: float
    distinct: int
    rival: int
    rival_only: int
    pose_only: int
    keyframe_distance_m: float
    position_sigma_m: float = float("inf")
    unrepeated: int | None = None
    contradicted: float = 0.0

    @property
    def inlier_ratio(self) -> float:
        """Inliers over matches."""
        return self.inliers / self.matches if self.matches else 0.0

    @property
    def distinct_share(self) -> float:
        """Distinct inliers over inliers."""
        return self.distinct / self.inliers if self.inliers else 0.0

    @property
    def distinct_coverage(self) -> float:
        """How much of the image distinct inliers speak for: a small patch has to be distinct altogether."""
        return self.coverage * self.distinct_share

    @property
    def unrepeated_share(self) -> float | None:
        """Inliers on things of which no view resembles anything elsewhere, over inliers."""
        return self.unrepeated / self.inliers if self.unrepeated is not None and self.inliers else None

    @staticmethod
    def none(matches: int = 0) -> Evidence:
        """Return the evidence for no pose at all."""
        return Evidence(matches, 0, 0.0, 0, 0, 0, 0, float("inf"))


@dataclass(frozen=True, slots=True)
class Limits:
    """What a pose must pass; measured on places that are in the map and on places that are not
    (docs/features.md)."""

    min_inliers: int = 12
    min_inlier_ratio: float = 0.06
    min_coverage: float = 0.14
    min_distinct_share: float = 0.55
    min_distinct_coverage: float = 0.11
    min_unrepeated_share: float = 0.3
    max_contradicted_share: float = 0.23
    max_rival_share: float = 0.45
    max_position_sigma_m: float = 0.15
    max_keyframe_distance_m: float = 12.0
    min_confidence: float = 0.8

    @staticmethod
    def none() -> Limits:
        """Return limits that let every pose pass."""
        return Limits(0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, float("inf"), float("inf"), 0.0)


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


def evidence_of(
    matches: Matches,
    inliers: Matches,
    camera: Camera,
    keyframe_distance_m: float,
    rival: Matches | None = None,
) -> Evidence:
    """Return the evidence from a picture's matches with a map, those that agree, and those that agree with a rival."""
    return gather_evidence(
        matches.query_rows,
        inliers.query_rows,
        inliers.points_px,
        inliers.distinct_count,
        np.zeros(0, np.intp) if rival is None else rival.query_rows,
        (camera.width, camera.height),
        keyframe_distance_m,
    )


def coverage(points_px: NDArray[np.float64], size_px: tuple[int, int]) -> float:
    """Return the share of the cells of an 8 x 6 grid over an image (width, height) that hold points (n, 2)."""
    cells = np.floor(points_px / np.array(size_px) * GRID).astype(int)
    cells = np.clip(cells, 0, np.array(GRID) - 1)
    return len(np.unique(cells[:, 0] * GRID[1] + cells[:, 1])) / (GRID[0] * GRID[1])


def judge(evidence: Evidence, position_sigma_m: float, limits: Limits) -> Reason | None:
    """Return why a pose can't be trusted, or None if it can."""
    inliers = evidence.inliers
    failed: tuple[tuple[bool, Reason], ...] = (
        (evidence.matches < limits.min_inliers, "no_match"),
        (inliers < limits.min_inliers, "too_few_inliers"),
        (evidence.inlier_ratio < limits.min_inlier_ratio, "too_few_inliers"),
        (evidence.coverage < limits.min_coverage, "too_few_inliers"),
        (position_sigma_m > limits.max_position_sigma_m, "too_few_inliers"),
        (evidence.distinct_share < limits.min_distinct_share, "ambiguous"),
        (evidence.distinct_coverage < limits.min_distinct_coverage, "ambiguous"),
        (_is_repeated(evidence, limits), "ambiguous"),
        (evidence.contradicted > limits.max_contradicted_share, "ambiguous"),
        (evidence.rival > limits.max_rival_share * inliers, "ambiguous"),
        (confidence_of(evidence) < limits.min_confidence, "too_few_inliers"),
        (evidence.keyframe_distance_m > limits.max_keyframe_distance_m, "outside_venue"),
    )
    return next((reason for fails, reason in failed if fails), None)


def _is_repeated(evidence: Evidence, limits: Limits) -> bool:
    """Whether a pose rests on things that are found elsewhere too: hardly any inlier is on something else, or fewer
    than another place explains altogether."""
    share = evidence.unrepeated_share
    if share is None or evidence.unrepeated is None or limits.min_unrepeated_share == 0.0:
        return False
    return share < limits.min_unrepeated_share or evidence.unrepeated < evidence.rival


@dataclass(frozen=True, slots=True)
class ConfidenceModel:
    """A logistic model of the probability that a pose is off by less than 0.5 m and 5 degrees.

    Weights of the inlier ratio, the coverage, minus the decimal logarithm of the position sigma in metres, the
    distinct share and the rival share (`features_of`). Fitted by `roomfix fit-confidence`.
    """

    intercept: float
    weights: tuple[float, float, float, float, float]

    def __call__(self, evidence: Evidence) -> float:
        score = self.intercept + float(np.dot(self.weights, features_of(evidence)))
        return float(1.0 / (1.0 + np.exp(-score)))


def features_of(evidence: Evidence) -> NDArray[np.float64]:
    """Return what the confidence of a pose is judged by, (5,)."""
    sigma_m = float(np.clip(evidence.position_sigma_m, 0.003, 1.0))
    rival_share = evidence.rival / evidence.inliers if evidence.inliers else 0.0
    return np.array(
        [
            evidence.inlier_ratio,
            evidence.coverage,
            -np.log10(sigma_m),
            evidence.distinct_share,
            rival_share,
        ]
    )


CONFIDENCE = ConfidenceModel(-2.87, (0.71, 2.5, 1.17, 3.92, -2.79))


def confidence_of(evidence: Evidence) -> float:
    """Return the probability that a pose with this evidence is off by less than 0.5 m and 5 degrees."""
    return CONFIDENCE(evidence) if evidence.inliers else 0.0
