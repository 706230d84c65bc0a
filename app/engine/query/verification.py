"""Whether a pose can be trusted: the evidence for and against it, the limits it must pass, and its confidence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from app.engine.query.intrinsics import CameraTrust
from app.engine.query.intrinsics_options import OPTIONS as CAMERA
from app.engine.query.matches import Matches
from app.engine.query.placed import Accuracy, Support
from app.engine.query.second.agreement import Agreement
from app.geometry.camera import Camera
from app.limits import limit

Reason = Literal["no_match", "too_few_inliers", "ambiguous", "outside_venue", "poor_image", "no_map"]

# Columns and rows of the grid on which `coverage` is counted.
GRID = (8, 6)

# How the limits of a trusted pose were chosen.
CHOSEN = "roomfix evaluate-demo and evaluate --absent: places in the map and places that are not; docs/features.md."
TWIN_PLACES = (
    "Pictures of one floor of the demonstration in a map of the other one, and right poses in its wing and corridors; "
    "docs/figures/unseen.md."
)
PLAIN_PLACES = (
    "roomfix evaluate-bare-rooms --building 1 --furnished --panoramas 14, and corridors of building 3 that are not in "
    "the map; docs/figures/evaluate-bare-rooms.md."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """What speaks for and against a pose.

    `inliers` and `matches` count features of the query, each once however many keyframes it was matched in.
    `coverage` is the share of an 8 x 6 grid over the image that holds inliers; `distinct` the inliers that
    resemble nothing elsewhere in the map; `rival` the inliers of the best other pose, `rival_only` those that the
    pose doesn't explain, `pose_only` the inliers that the rival doesn't; `keyframe_distance_m` how far the nearest
    keyframe is; `position_sigma_m` one sigma of the position by the geometry of the inliers; `unrepeated` the
    inliers on things of which no view resembles anything elsewhere (None: not counted); `contradicted` the share of
    the picture that speaks against the pose (`app.engine.query.contradiction`); `similarity_elsewhere` the largest
    cosine of the global descriptors of the matched keyframes and of keyframes at other places; `agreement` how far the
    picture looks as the pose says (None: not compared).
    """

    matches: int = 0
    inliers: int = 0
    coverage: float = 0.0
    distinct: int = 0
    rival: int = 0
    rival_only: int = 0
    pose_only: int = 0
    keyframe_distance_m: float = float("inf")
    position_sigma_m: float = float("inf")
    unrepeated: int | None = None
    contradicted: float = 0.0
    similarity_elsewhere: float = 0.0
    agreement: Agreement | None = None

    @property
    def support(self) -> Support:
        """How many features agree with the pose, and how many were matched."""
        return Support(self.inliers, self.matches)

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What a pose must pass. Measured on places that are in the map and on places that are not (docs/features.md)."""

    min_inliers: int = limit(
        12,
        "Fewest inliers of a trusted pose; the map's feature method has its own number.",
        chosen=CHOSEN,
    )
    min_inlier_ratio: float = limit(0.06, "Least inliers over matches.", chosen=CHOSEN)
    min_coverage: float = limit(
        0.14, "Least share of the image's grid cells that hold inliers.", chosen=CHOSEN
    )
    min_distinct_share: float = limit(
        0.55, "Least share of the inliers that resemble nothing at another place of the map.", chosen=CHOSEN
    )
    min_distinct_coverage: float = limit(0.11, "Least coverage times distinct share.", chosen=CHOSEN)
    min_unrepeated_share: float = limit(
        0.3, "Least share of the inliers on things of which no view resembles another place.", chosen=CHOSEN
    )
    min_similarity_elsewhere: float = limit(
        0.75,
        "From this cosine of global descriptors on, the pose is at a place that looks like another one.",
        chosen=TWIN_PLACES,
    )
    min_unrepeated_of_twin: int = limit(
        42,
        "Fewest inliers on things of which no view resembles another place, at a place that looks like another one.",
        chosen=TWIN_PLACES,
    )
    sure_unrepeated_share: float = limit(
        0.5, "With this share of such inliers fewer are enough there.", chosen=TWIN_PLACES
    )
    max_contradicted_share_of_twin: float = limit(
        0.15,
        "Largest share of the picture that may contradict a pose at a place that looks like another one, or whose "
        "inliers are repeated but for less than sure_unrepeated_share.",
        chosen=TWIN_PLACES + " Of 5,300 right answers on real recordings none is lost by the second.",
    )
    max_contradicted_share: float = limit(
        0.23, "Largest share of the picture that may contradict the pose.", chosen=CHOSEN
    )
    max_rival_share: float = limit(
        0.45, "Most inliers of the best other pose, over those of the pose.", chosen=CHOSEN
    )
    max_position_sigma_m: float = limit(0.15, "Largest standard deviation of the position.", chosen=CHOSEN)
    max_keyframe_distance_m: float = limit(
        12.0,
        "Farthest that a pose may be from the nearest keyframe.",
        chosen="By hand: the length of a large room.",
    )
    min_confidence: float = limit(0.8, "Least confidence of a trusted pose.", chosen=CHOSEN)
    min_agreeing_cells: int = limit(
        0,
        "Fewest cells of the picture that look as the pose says; of a second look alone.",
        chosen="By hand: the first look does not compare them.",
    )
    max_disagreeing_share: float = limit(
        1.0,
        "Largest share of the cells that do not look so, of those that do and do not; of a second look alone.",
        chosen="By hand, as above.",
    )
    min_clear_cells: int = limit(
        0,
        "Fewest agreeing cells of a picture that looks so clearly as the pose says that fewer inliers have to be "
        "unrepeated; of a second look alone (0: none does).",
        chosen="By hand, as above.",
    )
    max_disagreeing_share_of_clear: float = limit(
        0.1, "Largest share of the cells of such a picture that do not look so.", chosen=PLAIN_PLACES
    )
    min_unrepeated_of_clear: int = limit(
        25, "Fewest inliers of such a picture that are not repeated.", chosen=PLAIN_PLACES
    )
    min_unrepeated_share_of_clear: float = limit(0.3, "Least share of these inliers.", chosen=PLAIN_PLACES)
    max_similarity_of_clear: float = limit(
        0.8,
        "Cosine of global descriptors from which on its place looks like another one.",
        chosen=PLAIN_PLACES,
    )

    @staticmethod
    def none() -> Limits:
        """Return limits that let every pose pass."""
        return Limits(
            min_inliers=0,
            min_inlier_ratio=0.0,
            min_coverage=0.0,
            min_distinct_share=0.0,
            min_distinct_coverage=0.0,
            min_unrepeated_share=0.0,
            min_unrepeated_of_twin=0,
            max_contradicted_share_of_twin=1.0,
            max_contradicted_share=1.0,
            max_rival_share=1.0,
            max_position_sigma_m=float("inf"),
            max_keyframe_distance_m=float("inf"),
            min_confidence=0.0,
            min_agreeing_cells=0,
            max_disagreeing_share=1.0,
        )


def gather_evidence(
    *,
    matched_rows: NDArray[np.intp],
    inlier_rows: NDArray[np.intp],
    inlier_px: NDArray[np.float64],
    distinct_rows: NDArray[np.intp],
    rival_rows: NDArray[np.intp],
    size_px: tuple[int, int],
    keyframe_distance_m: float,
) -> Evidence:
    """Return the evidence from the rows of the query's features that were matched (m,), agree (n,), and agree
    with a rival (r,), those of them that agree and are distinct (d,), and the pixels (n, 2) of those that agree, in an
    image of `size_px` (width, height)."""
    return Evidence(
        matches=len(np.unique(matched_rows)),
        inliers=len(np.unique(inlier_rows)),
        coverage=coverage(inlier_px, size_px),
        distinct=len(np.unique(distinct_rows)),
        rival=len(np.unique(rival_rows)),
        rival_only=len(np.setdiff1d(rival_rows, inlier_rows)),
        pose_only=len(np.setdiff1d(inlier_rows, rival_rows)),
        keyframe_distance_m=keyframe_distance_m,
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
        matched_rows=matches.query_rows,
        inlier_rows=inliers.query_rows,
        inlier_px=inliers.points_px,
        distinct_rows=inliers.query_rows[inliers.distinct],
        rival_rows=np.zeros(0, np.intp) if rival is None else rival.query_rows,
        size_px=(camera.width, camera.height),
        keyframe_distance_m=keyframe_distance_m,
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
        (_may_be_twin(evidence, limits), "ambiguous"),
        (_is_contradicted(evidence, limits), "ambiguous"),
        (evidence.rival > limits.max_rival_share * inliers, "ambiguous"),
        (_is_unlike(evidence, limits), "ambiguous"),
        (confidence_of(evidence) < limits.min_confidence, "too_few_inliers"),
        (evidence.keyframe_distance_m > limits.max_keyframe_distance_m, "outside_venue"),
    )
    return next((reason for fails, reason in failed if fails), None)


def _is_unlike(evidence: Evidence, limits: Limits) -> bool:
    """Whether the picture does not look as the pose says, where that was compared."""
    found = evidence.agreement
    if found is None:
        return False
    too_few = found.agreeing < limits.min_agreeing_cells
    return too_few or found.disagreeing_share > limits.max_disagreeing_share


def _is_repeated(evidence: Evidence, limits: Limits) -> bool:
    """Whether a pose rests on things that are found elsewhere too: hardly any inlier is on something else, or fewer
    than another place explains altogether."""
    share = evidence.unrepeated_share
    if share is None or evidence.unrepeated is None or limits.min_unrepeated_share == 0.0:
        return False
    least = limits.min_unrepeated_share
    if _is_clear(evidence, limits):
        least = min(least, limits.min_unrepeated_share_of_clear)
    return share < least or evidence.unrepeated < evidence.rival


def _is_contradicted(evidence: Evidence, limits: Limits) -> bool:
    """Whether too much contradicts a pose: less is enough where most inliers are on what other walls have too."""
    share, most = evidence.unrepeated_share, limits.max_contradicted_share
    if share is not None and share < limits.sure_unrepeated_share:
        most = min(most, limits.max_contradicted_share_of_twin)
    return evidence.contradicted > most


def _is_clear(evidence: Evidence, limits: Limits) -> bool:
    """Whether the whole picture looks as the pose says, at a place that does not look like another one: edges and
    corners of plain rooms resemble each other, so that most inliers there are repeated."""
    found = evidence.agreement
    if found is None or limits.min_clear_cells == 0 or evidence.unrepeated is None:
        return False
    return (
        found.agreeing >= limits.min_clear_cells
        and found.disagreeing_share <= limits.max_disagreeing_share_of_clear
        and evidence.unrepeated >= limits.min_unrepeated_of_clear
        and evidence.similarity_elsewhere < limits.max_similarity_of_clear
    )


def _may_be_twin(evidence: Evidence, limits: Limits) -> bool:
    """Whether the picture may be of another place that looks like this one and is not in the map.

    A map with two such places may lack a third; then enough inliers must be on things that only this place has, and
    less of the picture may contradict the pose.
    """
    share = evidence.unrepeated_share
    if share is None or evidence.unrepeated is None:
        return False
    if evidence.similarity_elsewhere < limits.min_similarity_elsewhere:
        return False
    too_few = evidence.unrepeated < limits.min_unrepeated_of_twin and share < limits.sure_unrepeated_share
    return too_few or evidence.contradicted > limits.max_contradicted_share_of_twin


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
    exactness = -np.log10(sigma_m)
    return np.array(
        [evidence.inlier_ratio, evidence.coverage, exactness, evidence.distinct_share, rival_share]
    )


CONFIDENCE = ConfidenceModel(-2.87, (0.71, 2.5, 1.17, 3.92, -2.79))


def confidence_of(evidence: Evidence) -> float:
    """Return the probability that a pose with this evidence is off by less than 0.5 m and 5 degrees."""
    return CONFIDENCE(evidence) if evidence.inliers else 0.0


@dataclass(frozen=True, slots=True)
class CameraModel:
    """A logistic model of the same probability where the matches confirm no stated camera.

    Weights of what `camera_features_of` returns. Fitted by `roomfix fit-confidence`.
    """

    intercept: float
    weights: tuple[float, float]

    def __call__(self, features: NDArray[np.float64]) -> float:
        return float(1.0 / (1.0 + np.exp(-self.intercept - float(np.dot(self.weights, features)))))


def camera_features_of(inlier_ratio: float, sigma_m: float, trust: CameraTrust) -> NDArray[np.float64]:
    """Return what the confidence of a pose is judged by whose camera is not confirmed, (2,): minus the decimal
    logarithm of the accuracy in metres, and whether the matches may fit no camera."""
    return np.array([-np.log10(np.clip(sigma_m, 0.01, 2.0)), float(_fits_none(inlier_ratio, trust))])


def _fits_none(inlier_ratio: float, trust: CameraTrust) -> bool:
    return trust == "contradicted" or (trust == "open" and inlier_ratio < CAMERA.sure_inlier_ratio)


CAMERA_CONFIDENCE = CameraModel(4.87, (0.61, -1.27))


def confidence_with(
    evidence: Evidence, accuracy: Accuracy, trust: CameraTrust, model: CameraModel = CAMERA_CONFIDENCE
) -> float:
    """Return the probability that a pose is off by less than 0.5 m and 5 degrees, with what is known of its camera."""
    confidence = confidence_of(evidence)
    if trust == "confirmed":
        return confidence
    ratio = evidence.inlier_ratio
    by_camera = model(camera_features_of(ratio, accuracy.position_m, trust))
    is_far = accuracy.position_m > CAMERA.max_sure_sigma_m
    is_unsure = _fits_none(ratio, trust) or is_far or accuracy.orientation_deg > CAMERA.max_sure_sigma_deg
    return min(confidence, by_camera, CAMERA.unsure_confidence if is_unsure else 1.0)
