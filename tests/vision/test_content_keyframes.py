"""Keyframes by content: the similarity of B eq. 5, the rule of eq. 6, and no bursts where nothing new is seen."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise, product

import numpy as np
import pytest
from numpy.typing import NDArray

from app.geometry.se3 import Pose
from app.vision.content_keyframes import ContentRule, ContentSelector, FrameContent
from app.vision.matching import to_unit_vectors
from app.vision.similarity import content_similarity

RATIO = 0.85
SEEN, STEP = 120, 30
Floats = NDArray[np.float32]

WORLD = np.random.default_rng(3).normal(size=(3000, 64)).astype(np.float32)


def content(
    descriptors: Floats, x: float = 0.0, sharpness: float = 1.0, is_poor: bool = False
) -> FrameContent:
    return FrameContent(descriptors, sharpness, is_poor, Pose(np.eye(3), np.array([x, 0.0, 0.0])))


def walk(frames: int = 80, step: int = STEP) -> list[FrameContent]:
    """Return frames of a camera that passes a long wall, each of which sees a few features that the last didn't."""
    return [content(WORLD[i * step : i * step + SEEN], 0.05 * i) for i in range(frames)]


def noise(rng: np.random.Generator) -> Floats:
    return rng.normal(size=(SEEN, 64)).astype(np.float32)


def select(frames: list[FrameContent], rule: ContentRule) -> list[int]:
    return ContentSelector(rule, RATIO, False).select(frames)


def similarity(a: FrameContent, b: FrameContent) -> float:
    units = [to_unit_vectors(frame.descriptors, False) for frame in (a, b)]
    return content_similarity(units[0], units[1], RATIO)


def test_similarity_counts_twice_the_matches_over_all_features() -> None:
    a, b = WORLD[:100], WORLD[60:120]
    # 40 features of 160 are in both; random ones are far apart, so the ratio test leaves only those.
    assert similarity(content(a), content(b)) == pytest.approx(2 * 40 / 160)
    assert similarity(content(a), content(a)) == 1.0


def test_similarity_is_between_0_and_1_and_much_the_same_both_ways() -> None:
    rng = np.random.default_rng(5)
    sets = [content(rng.normal(size=(n, 8)).astype(np.float32)) for n in (30, 50, 2, 1, 0)]
    for a, b in product(sets, sets):
        assert 0.0 <= similarity(a, b) <= 1.0
    assert similarity(sets[-1], sets[-1]) == similarity(sets[0], sets[-1]) == 0.0
    for a, b in pairwise(walk(20)):
        assert similarity(a, b) == pytest.approx(similarity(b, a), abs=0.03)


@pytest.mark.parametrize(
    ("to_last", "to_before", "by_and", "by_or"),
    [(0.3, 0.1, True, True), (0.3, 0.3, False, True), (0.4, 0.1, False, True), (0.4, 0.3, False, False),
     (0.35, 0.2, True, True), (0.35, None, True, True), (0.36, None, False, False)],
)  # fmt: skip
def test_the_formula_wants_both_the_prose_one(
    to_last: float, to_before: float | None, by_and: bool, by_or: bool
) -> None:
    assert ContentRule(combine="and").admits(to_last, to_before) is by_and
    assert ContentRule(combine="or").admits(to_last, to_before) is by_or


@pytest.mark.parametrize("combine", ["and", "or"])
def test_keyframes_are_those_of_the_formula_step_by_step(combine: str) -> None:
    frames = walk()
    rule = ContentRule(0.5, 0.25, combine, seen="join", steady=False)  # type: ignore[arg-type]
    expected = [0]
    for i in range(1, len(frames)):
        to_last = similarity(frames[i], frames[expected[-1]])
        if len(expected) == 1:
            joins = to_last <= 0.5
        else:
            to_before = similarity(frames[i], frames[expected[-2]])
            parts = to_last <= 0.5, to_before <= 0.25
            joins = all(parts) if combine == "and" else any(parts)
        if joins:
            expected.append(i)
    assert len(expected) > 5
    assert select(frames, rule) == expected


def test_lower_limits_take_fewer_keyframes() -> None:
    counts = [len(select(walk(), ContentRule(alpha, alpha - 0.1))) for alpha in (0.6, 0.45, 0.3)]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > counts[-1] > 2


def shaken(frames: list[FrameContent]) -> list[FrameContent]:
    """Return the frames with runs of ten in which next to nothing can be found again."""
    rng = np.random.default_rng(1)
    return [
        content(noise(rng), frame.world_from_camera.translation[0], sharpness=0.9)
        if 9 < i % 30 < 20
        else frame
        for i, frame in enumerate(frames)
    ]


def test_blurred_frames_do_not_join_one_after_the_other() -> None:
    frames = walk()
    sharp = len(select(frames, ContentRule()))
    blurred = shaken(frames)
    assert len(select(blurred, ContentRule(steady=False, seen="join"))) > 1.5 * sharp
    chosen = select(blurred, ContentRule())
    assert len(chosen) <= 1.1 * sharp + 1
    assert not any(9 < i % 30 < 20 for i in chosen)


def test_frames_far_less_sharp_than_the_scan_do_not_join() -> None:
    frames = walk()
    dull = [
        content(f.descriptors, sharpness=0.3 if i % 2 else 1.0, is_poor=i % 4 == 2)
        for i, f in enumerate(frames)
    ]
    chosen = select(dull, ContentRule(seen="join"))
    assert len(chosen) > 3
    assert all(i % 4 == 0 for i in chosen)


def test_a_held_frame_counts_once() -> None:
    frames = shaken(walk())
    held = [frame for frame in frames for _ in range(3)]
    assert len(select(held, ContentRule())) == len(select(frames, ContentRule()))


def test_a_stretch_that_was_seen_before_adds_nothing() -> None:
    frames = walk(60)
    once = select(frames, ContentRule())
    assert select(frames * 2, ContentRule()) == once
    assert len(select(frames + frames[::-1], ContentRule())) <= 1.1 * len(once)
    assert len(select(frames * 2, ContentRule(seen="join"))) > 1.5 * len(once)


def test_the_first_usable_frame_joins_and_no_frames_give_no_keyframes() -> None:
    frames = walk(40)
    assert select([content(frames[0].descriptors, is_poor=True), *frames[1:]], ContentRule())[0] == 1
    assert select([], ContentRule()) == []
    assert select([content(np.zeros((0, 64), np.float32))], ContentRule()) == []


def test_frames_are_taken_one_by_one_from_a_long_scan() -> None:
    ahead: list[int] = []

    def stream() -> Iterator[FrameContent]:
        for i, frame in enumerate(walk(60)):
            ahead.append(i)
            yield frame

    assert ContentSelector(ContentRule(), RATIO, False).select(stream()) == select(walk(60), ContentRule())
    assert ahead == list(range(60))
