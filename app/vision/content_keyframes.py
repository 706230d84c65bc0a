"""Choice of keyframes by the content of the pictures (B 2.2, eq. 6), without blurred or empty ones."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain, islice
from typing import Literal

import numpy as np

from app.geometry.se3 import Pose
from app.limits import limit
from app.vision.features import Descriptors
from app.vision.matching import Unit, to_unit_vectors
from app.vision.similarity import content_similarity


@dataclass(frozen=True, slots=True, kw_only=True)
class ContentOptions:
    """Which frames of a scan can become keyframes by their content."""

    alpha: float = limit(
        0.35,
        "Largest similarity of a new keyframe to the last one, unless a build states another.",
        chosen="The Visual-Depth Map paper's value. `roomfix keyframes SCAN --sweep` compares others "
        "(docs/visual-depth-map.md).",
    )
    beta: float = limit(
        0.2,
        "Largest similarity of a new keyframe to the last but one, unless a build states another.",
        chosen="The Visual-Depth Map paper's value. `roomfix keyframes SCAN --sweep` compares others "
        "(docs/visual-depth-map.md).",
    )
    warm_up_frames: int = limit(
        30,
        "Frames that are read before the first decision, to know the usual sharpness and similarity.",
        chosen="By hand: enough for a stable median.",
    )
    min_sharpness_ratio: float = limit(
        0.5,
        "A frame is blurred when its sharpness is below this ratio of the scan's median.",
        chosen="By hand; `roomfix keyframes SCAN --bursts` shows the effect (docs/visual-depth-map.md).",
    )
    min_stability_ratio: float = limit(
        0.5,
        "A frame is rejected when its similarity to both neighbours is below this ratio of the scan's median.",
        chosen="By hand: blurred pictures and bare walls; `roomfix keyframes SCAN --bursts` shows the effect "
        "(docs/visual-depth-map.md).",
    )
    duplicate_similarity: float = limit(
        0.9,
        "A frame that is more similar than this to the one before it is a duplicate and is ignored.",
        chosen="By hand: only a frame that was recorded twice is so similar.",
    )
    sharper_frames: int = limit(
        4,
        "Frames after the first one that may join which are searched for a sharper one to take instead.",
        chosen="By hand: a camera moves little in so few frames.",
    )
    seen_radius_m: float = limit(
        1.5,
        "Earlier keyframes within this distance may show the same as a frame.",
        chosen="By hand: further away the same things differ in size.",
    )
    seen_angle_deg: float = limit(
        45.0,
        "Earlier keyframes may show the same as a frame when their optical axes differ by less than this angle.",
        chosen="By hand: at a larger angle two views overlap little.",
    )
    seen_keyframes: int = limit(
        8,
        "Largest number of earlier keyframes that a frame is compared with.",
        chosen="By hand: bounds the time.",
    )
    remembered_keyframes: int = limit(
        300,
        "Latest keyframes whose features are kept in memory for this comparison.",
        chosen="By hand: bounds the memory.",
    )


OPTIONS = ContentOptions()
ALPHA = OPTIONS.alpha
BETA = OPTIONS.beta
MIN_SEEN_COSINE = float(np.cos(np.radians(OPTIONS.seen_angle_deg)))


@dataclass(frozen=True, slots=True)
class ContentRule:
    """Limits of similarity to the last keyframe (`alpha`) and to the one before it (`beta`).

    `combine`: B states its eq. 6 with "and", its prose says "or". `seen`: a frame that shows the same as a keyframe
    before those two is skipped, or it may join, as by eq. 6 alone. `steady`: blurred and empty frames are skipped.
    """

    alpha: float = ALPHA
    beta: float = BETA
    combine: Literal["and", "or"] = "and"
    seen: Literal["skip", "join"] = "skip"
    steady: bool = True

    def admits(self, to_last: float, to_one_before: float | None) -> bool:
        """Return whether a frame joins, by its similarity to the last keyframe and to the one before it.

        With only one keyframe so far, alpha alone decides. Source: B eq. 6.
        """
        if to_one_before is None:
            return to_last <= self.alpha
        new, newer = to_last <= self.alpha, to_one_before <= self.beta
        return (new and newer) if self.combine == "and" else (new or newer)


@dataclass(frozen=True, slots=True)
class FrameContent:
    """What the rule needs of a frame: descriptors (n, d), sharpness, whether the picture is poor, and the pose."""

    descriptors: Descriptors
    sharpness: float
    is_poor: bool
    world_from_camera: Pose


@dataclass(frozen=True, slots=True)
class _Frame:
    row: int
    content: FrameContent
    unit: Unit
    to_previous: float


class _Ahead:
    """An iterator over frames that can also return the frames that follow, without consuming them."""

    def __init__(self, frames: Iterator[_Frame]) -> None:
        self._frames = frames
        self._waiting: deque[_Frame] = deque()

    def take(self) -> _Frame | None:
        """Return the next frame, None after the last."""
        return self._waiting.popleft() if self._waiting else next(self._frames, None)

    def peek(self, count: int) -> list[_Frame]:
        """Return up to `count` of the frames that follow; `take` still returns them later."""
        self._waiting.extend(islice(self._frames, max(0, count - len(self._waiting))))
        return list(islice(self._waiting, count))


class ContentSelector:
    """Chooses keyframes from frames in order. `ratio` and `binary` are those of the features' extractor.

    It keeps the features of a few frames and of the latest keyframes in memory, for a scan of any length.
    """

    def __init__(self, rule: ContentRule, ratio: float, binary: bool) -> None:
        self._rule, self._ratio, self._binary = rule, ratio, binary
        self._sharpness: list[float] = []
        self._to_previous: list[float] = []
        self._last: list[Unit] = []
        self._remembered: list[FrameContent] = []

    def select(self, frames: Iterable[FrameContent]) -> list[int]:
        """Return the rows of the frames that become keyframes.

        The first usable frame joins, then each that the rule admits. With `steady` a frame is skipped when it is much
        less sharp than the scan, or when neither of its neighbours is similar: such a frame is similar to no keyframe
        either, so that eq. 6 alone would admit all of them. Source: B eq. 6.
        """
        chosen = []
        ahead = _Ahead(self._warmed_up(self._compared(frames)))
        while (frame := ahead.take()) is not None:
            if not self._joins(frame, ahead):
                continue
            if self._rule.steady:
                frame = self._sharpest(frame, ahead)
            chosen.append(frame.row)
            self._last = [*self._last[-1:], frame.unit]
            self._remembered = [*self._remembered[1 - OPTIONS.remembered_keyframes :], frame.content]
        return chosen

    def _sharpest(self, first: _Frame, ahead: _Ahead) -> _Frame:
        """Return the sharpest of the first frame and the next few that show the same and may join as well.

        Blur lowers the similarity to the last keyframe, so the first frame below the limits is often a blurred one.
        """
        best, taken = first, 0
        for count, frame in enumerate(ahead.peek(OPTIONS.sharper_frames), 1):
            if self._similarity(frame.unit, first.unit) <= self._rule.alpha:
                break
            sharper = frame.content.sharpness > best.content.sharpness
            if sharper and self._admits(frame):
                best, taken = frame, count
        for _ in range(taken):
            ahead.take()
        return best

    def _compared(self, frames: Iterable[FrameContent]) -> Iterator[_Frame]:
        previous: Unit | None = None
        for row, content in enumerate(frames):
            unit = to_unit_vectors(content.descriptors, self._binary)
            similarity = 0.0 if previous is None else self._similarity(unit, previous)
            if similarity > OPTIONS.duplicate_similarity:
                continue
            self._sharpness.append(content.sharpness)
            if previous is not None:
                self._to_previous.append(similarity)
            yield _Frame(row, content, unit, similarity)
            previous = unit

    def _warmed_up(self, frames: Iterator[_Frame]) -> Iterator[_Frame]:
        """Yield all frames, the first one only after `warm_up_frames` were read."""
        yield from chain(list(islice(frames, OPTIONS.warm_up_frames)), frames)

    def _is_usual(self, frame: _Frame, to_next: float) -> bool:
        content = frame.content
        if content.is_poor or len(frame.unit) == 0:
            return False
        if content.sharpness < OPTIONS.min_sharpness_ratio * float(np.median(self._sharpness)):
            return False
        usual = float(np.median(self._to_previous)) if self._to_previous else 0.0
        return max(frame.to_previous, to_next) >= OPTIONS.min_stability_ratio * usual

    def _joins(self, frame: _Frame, ahead: _Ahead) -> bool:
        if self._rule.steady:
            following = ahead.peek(1)
            to_next = following[0].to_previous if following else 0.0
            if not self._is_usual(frame, to_next):
                return False
        return self._admits(frame)

    def _admits(self, frame: _Frame) -> bool:
        if not self._last:
            return True
        to_last = self._similarity(frame.unit, self._last[-1])
        to_one_before = self._similarity(frame.unit, self._last[0]) if len(self._last) > 1 else None
        if not self._rule.admits(to_last, to_one_before):
            return False
        return self._rule.seen == "join" or not self._was_seen(frame)

    def _was_seen(self, frame: _Frame) -> bool:
        """Return whether eq. 6 rejects the frame with the two most similar of the earlier keyframes nearby."""
        pose, earlier = frame.content.world_from_camera, self._remembered[:-2]
        if not earlier:
            return False
        positions = np.stack([keyframe.world_from_camera.translation for keyframe in earlier])
        axes = np.stack([keyframe.world_from_camera.rotation[:, 2] for keyframe in earlier])
        distances = np.linalg.norm(positions - pose.translation, axis=1)
        cosines = axes @ pose.rotation[:, 2]
        may_show = (distances < OPTIONS.seen_radius_m) & (cosines > MIN_SEEN_COSINE)
        cost = np.where(may_show, distances + 2.0 * (1.0 - cosines), np.inf)
        near = [i for i in np.argsort(cost)[: OPTIONS.seen_keyframes] if np.isfinite(cost[i])]
        units = [to_unit_vectors(earlier[i].descriptors, self._binary) for i in near]
        most = sorted((self._similarity(frame.unit, unit) for unit in units), reverse=True)
        return bool(most) and not self._rule.admits(most[0], most[1] if len(most) > 1 else None)

    def _similarity(self, a: Unit, b: Unit) -> float:
        return content_similarity(a, b, self._ratio, self._binary)
