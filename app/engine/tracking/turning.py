"""How far a camera turned from one frame to the next, told by the pictures alone: where flow begins to look.

A turn moves all of a picture by nearly the same, however far things are. Phase correlation (Kuglin and Hines, 1975)
finds that shift even where it is a third of the picture, much further than flow can reach by itself.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from app.geometry.camera import Camera
from app.vision.images import Gray

Array = NDArray[np.float64]
# Pictures are compared at this width: a turn is seen in their coarse structure.
WIDTH_PX = 128
# A lower peak of the correlation is noise.
MIN_RESPONSE = 0.04
# Flow reaches a shift of this share of the width by itself.
MIN_SHIFT_SHARE = 0.02


def shift_between(previous: Gray, present: Gray) -> Array | None:
    """Return by how many pixels (2,) the middle of a picture moved from one frame to the next of the same size;
    None when that is little, or can't be told."""
    height, width = previous.shape
    scale = WIDTH_PX / width
    size = (WIDTH_PX, max(round(scale * height), 2))
    small = [
        cv2.resize(gray, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        for gray in (previous, present)
    ]
    window = cv2.createHanningWindow(size, cv2.CV_32F)
    shift, response = cv2.phaseCorrelate(small[0], small[1], window)
    moved: Array = np.asarray(shift, dtype=np.float64) / scale
    if response < MIN_RESPONSE or np.linalg.norm(moved) < MIN_SHIFT_SHARE * width:
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
