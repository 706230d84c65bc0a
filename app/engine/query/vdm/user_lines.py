"""The user on the plan: the point nearest to the lines from keyframes through it (B eq. 14-16)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.query.vdm.keyframe_fix import KeyframeFix
from app.errors import DegenerateGeometryError
from app.geometry.alignment import average_poses
from app.geometry.lines import line_through, point_nearest_to_lines
from app.limits import limit

Array = NDArray[np.float64]

# The point with the least sum of distances, a median, has this many times the error of a mean of good lines.
MEDIAN_EFFICIENCY = float(np.sqrt(np.pi / 2))


@dataclass(frozen=True, slots=True, kw_only=True)
class UserLineOptions:
    """Which crossings of lines are the user."""

    max_crossing_sigma_m: float = limit(
        0.03,
        "Lines whose crossing has a larger standard deviation count as parallel.",
        chosen="roomfix evaluate --pipeline vdm; docs/visual-depth-map.md.",
    )
    max_sigmas: float = limit(
        4.0,
        "A crossing farther than this from where the keyframes' own points put the user is refused.",
        chosen="roomfix evaluate --pipeline vdm; docs/visual-depth-map.md.",
    )


OPTIONS = UserLineOptions()


@dataclass(frozen=True, slots=True)
class PlanPosition:
    """A point on the plan in world metres, its sigma (root mean square of both axes), and whether lines gave it."""

    x: float
    y: float
    sigma_m: float
    by_lines: bool


def user_on_plan(fixes: Sequence[KeyframeFix]) -> PlanPosition:
    """Return the user's place on the world's ground plane by at least one keyframe.

    Each keyframe gives a line through itself and the user; the user is where the sum of distances to them is least.
    Lines from keyframes in one row, or from one keyframe alone, are parallel or nearly so, and where they cross
    says nothing: then the keyframes' own poses of the user, which have depth, are averaged instead.
    """
    direct = _by_poses(fixes)
    crossing = _by_lines(fixes)
    if crossing is None or crossing.sigma_m > OPTIONS.max_crossing_sigma_m:
        return direct
    apart = float(np.hypot(crossing.x - direct.x, crossing.y - direct.y))
    if apart > OPTIONS.max_sigmas * float(np.hypot(crossing.sigma_m, direct.sigma_m)):
        return PlanPosition(direct.x, direct.y, max(direct.sigma_m, apart), False)
    return crossing


def _by_lines(fixes: Sequence[KeyframeFix]) -> PlanPosition | None:
    lines, sigmas = [], []
    for fix in fixes:
        try:
            line = line_through(fix.world_from_keyframe.translation[:2], fix.world_from_user.translation[:2])
        except DegenerateGeometryError:
            # The user stands where the keyframe was taken: no line, and none is needed for the others.
            continue
        lines.append(line)
        sigmas.append(float(np.sqrt(line[:2] @ fix.covariance[3:5, 3:5] @ line[:2])))
    if len(lines) < 2:
        return None
    try:
        x, y = point_nearest_to_lines(np.stack(lines))
    except DegenerateGeometryError:
        return None
    normals = np.stack(lines)[:, :2] / np.maximum(np.array(sigmas), 1e-4)[:, None]
    information = np.linalg.eigvalsh(normals.T @ normals)
    if information[0] < 1e-9:
        return None
    return PlanPosition(float(x), float(y), MEDIAN_EFFICIENCY * float(np.sqrt(np.sum(1 / information))), True)


def _by_poses(fixes: Sequence[KeyframeFix]) -> PlanPosition:
    middle = average_poses([fix.world_from_user for fix in fixes], weights=_shares(fixes)).translation
    own = float(np.sqrt(1.0 / np.sum([1.0 / _variance(fix) for fix in fixes])))
    spread = [np.linalg.norm(fix.world_from_user.translation[:2] - middle[:2]) for fix in fixes]
    scatter = float(np.sqrt(np.mean(np.square(spread)) / len(fixes)))
    return PlanPosition(float(middle[0]), float(middle[1]), max(own, scatter), False)


def _shares(fixes: Sequence[KeyframeFix]) -> Array:
    return np.array([1.0 / _variance(fix) for fix in fixes])


def _variance(fix: KeyframeFix) -> float:
    return max(float(np.trace(fix.covariance[3:5, 3:5])), 1e-8)
