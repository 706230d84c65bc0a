"""Whether the content rule takes keyframes that show nothing new: from blurred, held and repeated stretches."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.frame_images import frame_rgb
from app.engine.progress import Progress, map_in_order
from app.importers.frames import FrameSource
from app.vision.content_keyframes import ContentRule, ContentSelector, FrameContent
from app.vision.features import LocalFeatureExtractor
from app.vision.images import Gray, measure_quality, to_gray

# Frames of a run that is blurred or sharp as a whole.
SHAKEN_RUN = 10
# Of this number of runs one is blurred.
SHAKEN_EVERY = 3
# Lengths of the motion blur.
STREAKS_PX = (6.0, 12.0, 25.0)
HELD = 3


def count_bursts(
    source: FrameSource,
    sharp: Sequence[FrameContent],
    rule: ContentRule,
    extractor: LocalFeatureExtractor,
    executor: Executor,
    progress: Progress,
) -> list[tuple[str, int, int]]:
    """Return by stretch the keyframes of the rule, and those of eq. 6 alone, without its safeguards.

    The stretches are the scan's own frames, `sharp`; the same with a third of them shaken, in runs; that with each
    frame held for three; and the scan played twice.
    """
    stretches: list[tuple[str, list[FrameContent]]] = [("as scanned", list(sharp))]
    for length in STREAKS_PX:
        shaken = _shaken(source, sharp, length, extractor, executor, progress)
        stretches.append((f"a third blurred, {length:g} px", shaken))
        stretches.append(
            (f"a third blurred, {length:g} px, frames held", [f for f in shaken for _ in range(HELD)])
        )
    stretches.append(("played twice", [*sharp, *sharp]))
    stretches.append(("played, then back", [*sharp, *sharp[::-1]]))
    bare = replace(rule, seen="join", steady=False)

    def count(frames: Sequence[FrameContent], by: ContentRule) -> int:
        return len(ContentSelector(by, extractor.ratio, extractor.binary).select(frames))

    return [(name, count(frames, rule), count(frames, bare)) for name, frames in stretches]


def _shaken(
    source: FrameSource,
    sharp: Sequence[FrameContent],
    length_px: float,
    extractor: LocalFeatureExtractor,
    executor: Executor,
    progress: Progress,
) -> list[FrameContent]:
    rng = np.random.default_rng(0)
    streaks = [(length_px * rng.uniform(0.7, 1.3), rng.uniform(0, 180)) for _ in sharp]

    def content(row: int) -> FrameContent:
        if row // SHAKEN_RUN % SHAKEN_EVERY != 1:
            return sharp[row]
        gray = blurred(to_gray(frame_rgb(source, source.frames[row])), *streaks[row])
        quality = measure_quality(gray)
        return FrameContent(
            extractor.extract(gray).descriptors,
            quality.sharpness,
            quality.is_poor,
            sharp[row].world_from_camera,
        )

    return list(map_in_order(executor, content, range(len(sharp)), "blur", progress))


def blurred(gray: Gray, length_px: float, angle_deg: float) -> Gray:
    """Return a grey image as a camera takes it that moves by a streak while the shutter is open."""
    steps = max(2, round(4 * length_px))
    size = 2 * int(np.ceil(length_px / 2)) + 1
    offsets = np.linspace(-length_px / 2, length_px / 2, steps)
    direction = np.array([np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))])
    at = np.rint(offsets[:, None] * direction).astype(int) + size // 2
    kernel: NDArray[np.float32] = np.zeros((size, size), np.float32)
    np.add.at(kernel, (at[:, 1], at[:, 0]), 1.0 / steps)
    return np.asarray(cv2.filter2D(gray, -1, kernel), dtype=np.uint8)
