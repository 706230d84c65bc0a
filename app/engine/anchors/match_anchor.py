"""Full matching of a phone image with one anchor, and the fix by the matches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.engine.anchors.anchor import AnchorSpec
from app.engine.anchors.features import AnchorFeatures
from app.engine.anchors.fix import AnchorFix, MountedCamera, fix_by_anchor
from app.engine.anchors.matching import match_akaze, match_xfeat
from app.engine.floors.walls import FloorWalls
from app.engine.stage_timer import StageTimer
from app.geometry.camera import Camera


def match_anchor(
    spec: AnchorSpec,
    monitor: tuple[AnchorFeatures, Camera],
    phone: tuple[AnchorFeatures, Camera],
    gravity: NDArray[np.float64] | None,
    mounted: MountedCamera | None,
    timer: StageTimer,
    walls: FloorWalls | None = None,
) -> tuple[AnchorFix | None, int]:
    """Return the fix by an anchor, or None, and the number of matches.

    `gravity` (3,) is down in the phone's axes, `walls` are the floor's in metres of its plan.
    """
    matches = match_akaze(monitor[0], phone[0]).with_more(match_xfeat(monitor[0], phone[0]))
    timer.lap("match")
    regions, dense = monitor[0].regions, phone[0].dense
    fix = fix_by_anchor(
        spec,
        monitor[1],
        phone[1],
        matches,
        gravity,
        mounted,
        monitor[0].down,
        None if regions is None or dense is None else (regions, dense),
        walls,
    )
    timer.lap("pose")
    return fix, len(matches)
