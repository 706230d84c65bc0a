"""How much a picture moves from frame to frame, how sharp it is, and which frames are chosen by both."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.limits import limit
from app.vision.images import Gray


@dataclass(frozen=True, slots=True, kw_only=True)
class ChoiceOptions:
    """Which frames of a video take part in the reconstruction."""

    side_px: int = limit(
        320,
        "Motion and sharpness are measured in pictures of this longer side.",
        chosen="By hand: 3 ms a frame.",
    )
    step_ratio: float = limit(
        0.06,
        "Motion of the picture from one chosen frame to the next, as a ratio of its longer side.",
        chosen="By hand: neighbours then share most of their view, and 10 to 20 of them see the same point.",
    )
    least_step_ratio: float = limit(
        0.6,
        "The sharpest frame after this ratio of a step is chosen.",
        chosen="By hand: room to find a sharp one.",
    )
    most_step_ratio: float = limit(
        1.2, "The sharpest frame before this ratio of a step is chosen.", chosen="By hand: as the least."
    )
    max_frames: int = limit(
        700,
        "Frames that are chosen at most; a longer video gets longer steps.",
        chosen="By hand: the time of the reconstruction grows faster than their number.",
    )
    corners: int = limit(
        200, "Corners that are followed from frame to frame.", chosen="By hand: the median is used."
    )
    corner_quality: float = limit(
        0.01, "OpenCV's quality level of corners.", chosen="By hand: OpenCV's usual value."
    )
    corner_distance_px: float = limit(8.0, "Least distance of two corners.", chosen="By hand: spreads them.")
    min_followed_share: float = limit(
        0.5,
        "Share of the corners that must be found again; else the motion is not known, and both pictures are chosen.",
        chosen="By hand: a cut of the video, or a fast turn.",
    )


OPTIONS = ChoiceOptions()


@dataclass(slots=True)
class MotionMeter:
    """Measures pictures in their order: `steps` are the motion since the one before, as a ratio of the longer side, NaN
    where too little could be followed; `sharpness` is the variance of the Laplacian."""

    steps: list[float]
    sharpness: list[float]
    _before: Gray | None = None

    @staticmethod
    def start() -> MotionMeter:
        """Return a meter that has seen nothing."""
        return MotionMeter([], [])

    def add(self, gray: Gray) -> None:
        """Measure the next picture, grey (height, width) of any size."""
        scale = OPTIONS.side_px / max(gray.shape)
        size = max(1, round(scale * gray.shape[1])), max(1, round(scale * gray.shape[0]))
        small = np.asarray(cv2.resize(gray, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        self.sharpness.append(float(cv2.Laplacian(small, cv2.CV_32F).var()))
        self.steps.append(0.0 if self._before is None else _motion(self._before, small))
        self._before = small


def _motion(before: Gray, after: Gray) -> float:
    if before.shape != after.shape:
        return float("nan")
    corners = cv2.goodFeaturesToTrack(
        before, OPTIONS.corners, OPTIONS.corner_quality, OPTIONS.corner_distance_px
    )
    if corners is None:
        return 0.0
    moved, found, _ = cv2.calcOpticalFlowPyrLK(before, after, corners, np.empty_like(corners))
    followed = found[:, 0] > 0
    if followed.mean() < OPTIONS.min_followed_share:
        return float("nan")
    lengths = np.linalg.norm((moved - corners)[followed, 0], axis=1)
    return float(np.median(lengths)) / OPTIONS.side_px


def choose_frames(steps: Sequence[float], sharpness: Sequence[float], wanted: Collection[int]) -> list[int]:
    """Return the numbers of the chosen frames, in order: the sharpest one of each step of motion, and all `wanted`.

    Before and after a step that is not known no frame is left out: where the camera turns fast, what two pictures share
    is soon gone.
    """
    unknown = np.isnan(np.asarray(steps, dtype=np.float64))
    way = np.cumsum(np.where(unknown, OPTIONS.step_ratio, steps))
    turning = set(np.flatnonzero(unknown).tolist())
    turning |= {max(0, number - 1) for number in turning}
    step = max(OPTIONS.step_ratio, float(way[-1]) / OPTIONS.max_frames)
    chosen = [_sharpest(sharpness, np.flatnonzero(way <= OPTIONS.least_step_ratio * step))]
    while True:
        since = way - way[chosen[-1]]
        later = np.arange(len(way)) > chosen[-1]
        far = later & (since >= OPTIONS.least_step_ratio * step)
        if not far.any():
            break
        near = np.flatnonzero(far & (since <= OPTIONS.most_step_ratio * step))
        chosen.append(_sharpest(sharpness, near if len(near) else np.flatnonzero(far)[:1]))
    return sorted({*chosen, *turning, *wanted})


def _sharpest(sharpness: Sequence[float], among: NDArray[np.intp]) -> int:
    return int(max(among, key=lambda number: sharpness[number]))
