"""How far a camera turned from one frame to the next, told by the pictures alone: where flow begins to look.

A turn moves all of a picture by nearly the same, however far things are. Phase correlation (Kuglin and Hines, 1975)
finds that shift even where it is a third of the picture, much further than flow can reach by itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.geometry.camera import Camera
from app.limits import limit
from app.vision.images import Gray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class TurningOptions:
    """How a turn is seen in two pictures."""

    width_px: int = limit(
        128,
        "Width at which pictures are compared: a turn shows in their coarse structure.",
        chosen="roomfix track and track-anchors; docs/sessions.md.",
    )
    min_response: float = limit(
        0.04,
        "Peaks of the phase correlation below this are noise.",
        chosen="roomfix track and track-anchors; docs/sessions.md.",
    )
    min_shift_share: float = limit(
        0.02,
        "Optical flow finds shifts of up to this share of the width by itself.",
        chosen="roomfix track and track-anchors; docs/sessions.md.",
    )


OPTIONS = TurningOptions()


def shift_between(previous: Gray, present: Gray) -> Array | None:
    """Return by how many pixels (2,) the middle of a picture moved from one frame to the next of the same size;
    None when that is little, or can't be told."""
    height, width = previous.shape
    scale = OPTIONS.width_px / width
    size = (OPTIONS.width_px, max(round(scale * height), 2))
    small = [
        cv2.resize(gray, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        for gray in (previous, present)
    ]
    window = cv2.createHanningWindow(size, cv2.CV_32F)
    shift, response = cv2.phaseCorrelate(small[0], small[1], window)
    moved: Array = np.asarray(shift, dtype=np.float64) / scale
    if response < OPTIONS.min_response or np.linalg.norm(moved) < OPTIONS.min_shift_share * width:
        return None
    return moved


def turned(points_px: Array, camera: Camera, shift_px: Array) -> Array:
    """Return where pixels (n, 2) are after a turn that moves the middle of the picture by `shift_px` (2,).

    Of all turns that do, the one without roll: a phone is turned about its upright axis, and tilted.
    """
    focal_px = camera.focal_px
    pan, tilt = np.arctan2(shift_px[0], focal_px), np.arctan2(shift_px[1], focal_px)
    about_y = cv2.Rodrigues(np.array([0.0, pan, 0.0]))[0]
    about_x = cv2.Rodrigues(np.array([-tilt, 0.0, 0.0]))[0]
    rays = np.column_stack([camera.normalize(points_px), np.ones(len(points_px))]) @ (about_x @ about_y).T
    ahead = rays[:, 2] > 0.1
    moved = points_px.copy()
    moved[ahead] = camera.project(rays[ahead])
    return moved
