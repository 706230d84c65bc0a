"""Whether the frames of a scan are too far apart to show the same things, by its poses alone."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from app.geometry.camera import Camera
from app.geometry.se3 import attitude_difference_rad
from app.importers.frames import Scan
from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class SparsenessOptions:
    """When the frames of a scan are too far apart."""

    turn_ratio: float = limit(
        0.5,
        "Median turn between neighbouring frames, over the field of view, above which they share too little.",
        chosen="By hand: half of the view is shared.",
    )


OPTIONS = SparsenessOptions()


def is_sparse(scan: Scan) -> bool:
    """Return whether neighbouring frames of a scan mostly show different things, if its poses are right."""
    return usual_turn_deg(scan) > OPTIONS.turn_ratio * field_of_view_deg(scan.camera)


def usual_turn_deg(scan: Scan) -> float:
    """Return the median angle in degrees between the poses of neighbouring frames; 0 of a single frame."""
    poses = [frame.scan_from_camera for frame in scan.frames]
    turns = [attitude_difference_rad(first, second) for first, second in pairwise(poses)]
    return float(np.degrees(np.median(turns))) if turns else 0.0


def field_of_view_deg(camera: Camera) -> float:
    """Return the angle in degrees that a camera sees along the longer side of its picture, its lens left aside."""
    return float(2 * np.degrees(np.arctan(0.5 * max(camera.width, camera.height) / camera.focal_px)))
