"""Choice of keyframes by what the pictures show (B 2.2, eq. 6), and what a picture must be to become one."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain, islice
from typing import Literal

import numpy as np

from app.geometry.se3 import Pose
from app.vision.features import Descriptors
from app.vision.matching import Unit, to_unit_vectors
from app.vision.similarity import content_similarity

ALPHA, BETA = 0.35, 0.2
# What is usual in a scan is known once this many frames were seen.
WARM_UP = 30
# A frame this much less sharp than what is usual is blurred.
BLURRED_SHARE = 0.5
# A frame that shares less than this part of what neighbours usually share, with both of its own, shows
# nothing that can be found again: blur, or a wall without anything on it.
UNSTABLE_SHARE = 0.5
# Two frames that share more than this are one that was recorded twice, and no neighbours to compare with.
DUPLICATE = 0.9
# Frames that may follow the first one below the limits and be taken in its place.
PATIENCE = 4
# Earlier keyframes that may show the same: near in place and direction, and the most that are looked at.
SEEN_M, SEEN_COSINE, SEEN_COUNT = 1.5, float(np.cos(np.radians(45))), 8
# Keyframes whose features are remembered for that.
REMEMBERED = 300


@dataclass(frozen=True, slots=True)
class ContentRule:
    """Limits of similarity to the last keyframe (`alpha`) and to the one before it (`beta`).

    B states its eq. 6 with "and", its prose says "or": `combine`. `seen` says what becomes of a frame that shows
    what a keyframe before those two shows: `skip`, or `join` as eq. 6 alone has it.
    """

    alpha: float = ALPHA
    beta: float = BETA
    combine: Literal["and", "or"] = "and"
    seen: Literal["skip", "join"] = "skip"
    steady: bool = True

    def admits(self, to_last: float, to_one_before: float | None) -> bool:
        """Return whether a frame joins, from its similarity to the last keyframe and to the one before it.

        Without a keyframe before the last one, alpha alone decides. Source: B eq. 6.
        """
        if to_one_before is None:
            return to_last <= self.alpha
        new, newer = to_last <= self.alpha, to_one_before <= self.beta
        return (new and newer) if self.combine == "and" else (new or newer)


@dataclass(frozen=True, slots=True)
class FrameContent:
    """What the rule looks at: descriptors (n, d), `sharpness`, whether the picture is `poor`, and its pose."""

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
    """Frames one by one, with a look at those that follow."""

    def __init__(self, frames: Iterator[_Frame]) -> None:
        self._frames = frames
        self._waiting: deque[_Frame] = deque()

    def take(self) -> _Frame | None:
        """Return the next frame, None after the last."""
        return self._waiting.popleft() if self._waiting else next(self._frames, None)

    def look(self, count: int) -> list[_Frame]:
        """Return up to `count` of the frames that follow, which stay."""
        self._waiting.extend(islice(self._frames, max(0, count - len(self._waiting))))
        return list(islice(self._waiting, count))


class ContentSelector:
    """Chooses keyframes from frames in order, with the extractor's `ratio` and whether descriptors are `binary`.

    Holds the features of a few frames and of the latest keyframes, however long the scan is.
    """

    def __init__(self, rule: ContentRule, ratio: float, binary: bool) -> None:
        self._rule, self._ratio, self._binary = rule, ratio, binary
        self._sharpness: list[float] = []
        self._to_previous: list[float] = []
        self._last: list[Unit] = []
        self._remembered: list[FrameContent] = []

    def select(self, frames: Iterable[FrameContent]) -> list[int]:
        """Return the rows of the frames that become keyframes.

        The first usable frame joins, then each that the rule admits. With `steady` a frame that is much blurrier
        than the scan, or that neither of its neighbours resembles, is passed over: it is like nothing, so eq. 6
        alone would take one such frame after the other. Source: B eq. 6.
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
            self._remembered = [*self._remembered[1 - REMEMBERED :], frame.content]
        return chosen

    def _sharpest(self, first: _Frame, ahead: _Ahead) -> _Frame:
        """Return the sharpest of the next few frames that show what the first one shows and would join as well.

        Similarity falls where a picture is a little blurred: the very first frame below the limits is often one.
        """
        best, taken = first, 0
        for count, frame in enumerate(ahead.look(PATIENCE), 1):
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
            if similarity > DUPLICATE:
                continue
            self._sharpness.append(content.sharpness)
            if previous is not None:
                self._to_previous.append(similarity)
            yield _Frame(row, content, unit, similarity)
            previous = unit

    def _warmed_up(self, frames: Iterator[_Frame]) -> Iterator[_Frame]:
        """Yield all frames, the first one when what is usual is known."""
        yield from chain(list(islice(frames, WARM_UP)), frames)

    def _is_usual(self, frame: _Frame, to_next: float) -> bool:
        content = frame.content
        if content.is_poor or len(frame.unit) == 0:
            return False
        if content.sharpness < BLURRED_SHARE * float(np.median(self._sharpness)):
            return False
        usual = float(np.median(self._to_previous)) if self._to_previous else 0.0
        return max(frame.to_previous, to_next) >= UNSTABLE_SHARE * usual

    def _joins(self, frame: _Frame, ahead: _Ahead) -> bool:
        if self._rule.steady:
            following = ahead.look(1)
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
        """Return whether eq. 6 turns the frame down by the two most similar of the earlier keyframes nearby."""
        pose, earlier = frame.content.world_from_camera, self._remembered[:-2]
        if not earlier:
            return False
        places = np.stack([keyframe.world_from_camera.translation for keyframe in earlier])
        axes = np.stack([keyframe.world_from_camera.rotation[:, 2] for keyframe in earlier])
        distances = np.linalg.norm(places - pose.translation, axis=1)
        cosines = axes @ pose.rotation[:, 2]
        cost = np.where(
            (distances < SEEN_M) & (cosines > SEEN_COSINE), distances + 2.0 * (1.0 - cosines), np.inf
        )
        near = [i for i in np.argsort(cost)[:SEEN_COUNT] if np.isfinite(cost[i])]
        units = [to_unit_vectors(earlier[i].descriptors, self._binary) for i in near]
        most = sorted((self._similarity(frame.unit, unit) for unit in units), reverse=True)
        return bool(most) and not self._rule.admits(most[0], most[1] if len(most) > 1 else None)

    def _similarity(self, a: Unit, b: Unit) -> float:
        return content_similarity(a, b, self._ratio, self._binary)
