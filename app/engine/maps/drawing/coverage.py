"""Where on a floor a phone would be located, by the direction in which it looks: from the keyframes around."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from app.engine.maps.artifact import MapArtifact
from app.geometry.plan import plan_position
from app.limits import limit

DIRECTIONS = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class CoverageOptions:
    """What a phone at a place is taken to see of the keyframes around it."""

    reach_m: float = limit(
        1.5,
        "Keyframes within this distance of a place are taken to show what a phone there sees.",
        chosen="By hand: as far as a keyframe's points are refined by other views.",
    )
    max_axes_angle_deg: float = limit(
        45.0,
        "Largest angle on the plan between a keyframe's direction and the phone's.",
        chosen="By hand: half a quarter turn; beyond it features look too different.",
    )
    half_view_deg: float = limit(
        30.0,
        "Half of the horizontal angle of view of a phone.",
        chosen="By hand: common phones, held upright or across, see 50 to 70 degrees.",
    )
    near_m: float = limit(
        0.3, "Points nearer than this are out of the phone's focus.", chosen="By hand: an arm's length."
    )
    far_m: float = limit(
        12.0,
        "Points farther than this are too small to be found again.",
        chosen="By hand: twice the range of depth cameras.",
    )
    sampled_points: int = limit(
        64,
        "Points of a keyframe that are looked at.",
        chosen="By hand: the share in view is known to some percent.",
    )
    min_features: int = limit(
        100,
        "Least number of features in view that one keyframe shares with the phone, for the place to count as covered.",
        chosen="By hand: about half are found again from another place, and 50 matches are wanted of a keyframe.",
    )


OPTIONS = CoverageOptions()


@dataclass(frozen=True, slots=True)
class Coverage:
    """Cells of a grid on the plan: centres (n, 2) in metres, and the most features in view that one keyframe shares.

    `features` (n, 8) is for the directions k * 45 degrees, counter-clockwise from plan x.
    """

    centres: NDArray[np.float64]
    features: NDArray[np.int64]

    @property
    def is_covered(self) -> NDArray[np.bool_]:
        """Whether a phone would be located, (n, 8)."""
        return np.asarray(self.features >= OPTIONS.min_features)


def coverage_of(
    artifact: MapArtifact,
    plan_from_world: NDArray[np.float64],
    keyframes: NDArray[np.intp],
    cell_m: float,
) -> Coverage:
    """Return the coverage of a floor around its keyframes (k,); empty without any."""
    if len(keyframes) == 0:
        return Coverage(np.zeros((0, 2)), np.zeros((0, DIRECTIONS), np.int64))
    placed = np.array([plan_position(plan_from_world, artifact.pose(int(k))) for k in keyframes])
    counts = np.diff(artifact.arrays.offsets)[keyframes]
    samples = _samples(artifact, plan_from_world, keyframes)
    centres = _cells(placed[:, :2], cell_m)
    near = cKDTree(placed[:, :2]).query_ball_point(centres, OPTIONS.reach_m)
    features = np.zeros((len(centres), DIRECTIONS), np.int64)
    for row, (centre, around) in enumerate(zip(centres, near, strict=True)):
        if around:
            features[row] = _in_view(centre, placed[around, 2], samples[around], counts[around])
    seen = np.array([bool(around) for around in near])
    return Coverage(centres[seen], features[seen])


def _samples(
    artifact: MapArtifact, plan_from_world: NDArray[np.float64], keyframes: NDArray[np.intp]
) -> NDArray[np.float64]:
    """Return plan points (k, s, 2) of each keyframe, evenly drawn from its features; infinite where it has none."""
    drawn = np.full((len(keyframes), OPTIONS.sampled_points, 2), np.inf)
    for row, keyframe in enumerate(keyframes):
        span = artifact.rows(int(keyframe))
        if span.stop > span.start:
            rows = np.linspace(span.start, span.stop - 1, OPTIONS.sampled_points).round().astype(int)
            points = artifact.arrays.points_in_world[rows].astype(np.float64)
            drawn[row] = (points @ plan_from_world[:3, :3].T + plan_from_world[:3, 3])[:, :2]
    return drawn


def _cells(places: NDArray[np.float64], cell_m: float) -> NDArray[np.float64]:
    """Return the centres (n, 2) of a grid over the places and what is in reach of them."""
    low = np.floor((places.min(axis=0) - OPTIONS.reach_m) / cell_m)
    high = np.ceil((places.max(axis=0) + OPTIONS.reach_m) / cell_m)
    axes = [(np.arange(a, b) + 0.5) * cell_m for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)


def _in_view(
    centre: NDArray[np.float64],
    headings_deg: NDArray[np.float64],
    samples: NDArray[np.float64],
    counts: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Return for each direction (8,) the most features of one keyframe that a phone at `centre` has in view."""
    with np.errstate(invalid="ignore"):
        offsets = samples - centre
        distances = np.hypot(offsets[..., 0], offsets[..., 1])
        angles = np.degrees(np.arctan2(offsets[..., 1], offsets[..., 0]))
    in_range = (distances > OPTIONS.near_m) & (distances < OPTIONS.far_m)
    directions = np.arange(DIRECTIONS) * (360.0 / DIRECTIONS)
    in_view = in_range[..., None] & (_apart_deg(angles[..., None], directions) < OPTIONS.half_view_deg)
    similar = _apart_deg(headings_deg[:, None], directions) <= OPTIONS.max_axes_angle_deg
    shared = in_view.mean(axis=1) * counts[:, None] * similar
    return np.asarray(shared.max(axis=0).round().astype(np.int64))


def _apart_deg(a: NDArray[np.floating], b: NDArray[np.floating]) -> NDArray[np.float64]:
    return np.asarray(np.abs((a - b + 180.0) % 360.0 - 180.0))
