"""What a tracker is told with each frame: what gives fixes now, and where a camera can be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from app.engine.tracking.anchor_fixes import AnchorFixes
from app.engine.tracking.fix import FixSource
from app.engine.tracking.plan_walk.plans import Plans
from app.geometry.se3 import Pose


def _everywhere(_pose: Pose) -> bool:
    return True


def _never(_pose: Pose, _away_s: float) -> bool:
    return False


@dataclass(frozen=True, slots=True)
class Surroundings:
    """A building as a tracker sees it.

    `is_inside` says of a pose in the world whether a camera can be there, `can_change_floor` whether one that was
    there some seconds ago may be on another floor by now. A tracker without a map goes
    by `plans` and `anchors`.
    """

    source: FixSource
    is_inside: Callable[[Pose], bool] = _everywhere
    can_change_floor: Callable[[Pose, float], bool] = _never
    plans: Plans | None = None
    anchors: AnchorFixes | None = None
