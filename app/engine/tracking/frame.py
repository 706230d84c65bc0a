"""One frame of a video as tracking uses it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.limits import limit
from app.vision.images import Gray, Rgb, shrink, to_gray

# Width and height of the window that flow compares, pixels.
WINDOW_PX = (21, 21)


@dataclass(frozen=True, slots=True, kw_only=True)
class FlowOptions:
    """How points are followed by pyramidal Lucas-Kanade flow."""

    max_side_px: int = limit(
        640,
        "Longer side to which images are shrunk: flow on more pixels costs more and finds no more points.",
        chosen="roomfix track and track-anchors; docs/sessions.md.",
    )
    pyramid_levels: int = limit(
        3,
        "Levels of the pyramid above the image.",
        chosen="roomfix track and track-anchors; docs/sessions.md.",
    )
    max_return_px: float = limit(
        1.0,
        "A point followed back must return to within this.",
        chosen="roomfix track and track-anchors; docs/sessions.md.",
    )


OPTIONS = FlowOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackingFrame:
    """A frame: the image as it came, its grey copy (height, width) at tracking size, and when it was taken, in seconds
    of any clock.

    What the phone may say of it: `gravity` is down (3,) in camera axes, `camera` the one of the image as it came,
    `motion` its own odometry, this frame's camera in the axes of the previous one's, metres.
    """

    rgb: Rgb
    gray: Gray
    time_s: float
    gravity: tuple[float, float, float] | None = None
    camera: Camera | None = None
    motion: Pose | None = None

    @staticmethod
    def of(
        rgb: Rgb,
        time_s: float,
        gravity: tuple[float, float, float] | None = None,
        camera: Camera | None = None,
        motion: Pose | None = None,
    ) -> TrackingFrame:
        """Return the frame of an image (height, width, 3)."""
        gray = to_gray(shrink(rgb, OPTIONS.max_side_px)[0])
        return TrackingFrame(rgb=rgb, gray=gray, time_s=time_s, gravity=gravity, camera=camera, motion=motion)

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height at tracking size."""
        return self.gray.shape[1], self.gray.shape[0]

    def scaled(self, camera: Camera) -> Camera:
        """Return the camera at tracking size."""
        return camera.scaled_to(*self.size_px)


def follow(
    previous: Gray,
    frame: TrackingFrame,
    points_px: NDArray[np.float64],
    expected_px: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Follow points (n, 2) into the next frame by pyramidal Lucas-Kanade flow; both frames have one size.

    With `expected_px` (n, 2) each is looked for there. Returns where they are (n, 2), and which (n,) came back to
    where they started, within a pixel, when followed the other way round, and are still in the picture.
    """
    if len(points_px) == 0:
        return points_px, np.zeros(0, dtype=bool)
    start = points_px.astype(np.float32)[:, None]
    step = None if expected_px is None else expected_px.astype(np.float32)[:, None] - start
    there, found, _ = _flow(previous, frame.gray, start, step)
    back, returned, _ = _flow(frame.gray, previous, there, None if step is None else -step)
    error = np.abs(back - start).max(axis=2)[:, 0]
    moved = there[:, 0].astype(np.float64)
    inside = ((moved >= 0) & (moved < np.array(frame.size_px) - 1)).all(axis=1)
    return moved, (found[:, 0] == 1) & (returned[:, 0] == 1) & (error < OPTIONS.max_return_px) & inside


def _flow(a: Gray, b: Gray, points: Any, step: Any) -> Any:
    """Follow points from one image to another, beginning a step away from where they were."""
    guess: Any = None if step is None else points + step
    flags = 0 if step is None else cv2.OPTFLOW_USE_INITIAL_FLOW
    return cv2.calcOpticalFlowPyrLK(
        a, b, points, guess, winSize=WINDOW_PX, maxLevel=OPTIONS.pyramid_levels, flags=flags
    )


def find_corners(
    gray: Gray, known_px: NDArray[np.float64], count: int, distance_px: int = 12
) -> NDArray[np.float64]:
    """Return up to `count` corners (m, 2) of a grey image, none of them near points known already (n, 2)."""
    mask = np.full(gray.shape, 255, np.uint8)
    for u, v in np.rint(known_px).astype(int):
        cv2.circle(mask, (int(u), int(v)), distance_px, 0, -1)
    corners = cv2.goodFeaturesToTrack(gray, count, 0.01, distance_px, mask=mask, blockSize=5)
    return np.zeros((0, 2)) if corners is None else corners[:, 0].astype(np.float64)
