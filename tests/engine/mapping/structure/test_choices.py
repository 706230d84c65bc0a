"""Which frames of a video are chosen, and which pictures are compared."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from app.engine.mapping.structure import matches, motion
from app.engine.mapping.structure.matches import features_of, pairs_to_compare
from app.engine.mapping.structure.motion import MotionMeter, choose_frames
from app.vision.local_features import create_extractor

STEP = motion.OPTIONS.step_ratio


def test_frames_are_a_step_apart_and_the_sharpest_of_each() -> None:
    steps = [0.0, *[STEP / 10] * 95]
    sharpness = [100.0 + (number % 10 == 0) for number in range(96)]
    chosen = choose_frames(steps, sharpness, ())
    assert all(number % 10 == 0 for number in chosen)
    assert np.diff(chosen).max() <= 10


def test_a_camera_that_stands_still_gives_one_frame() -> None:
    assert len(choose_frames([0.0] * 50, [1.0] * 50, ())) == 1


def test_wanted_frames_are_chosen_whatever_they_are() -> None:
    assert 17 in choose_frames([0.0] * 50, [1.0] * 50, {17})


def test_a_jump_of_a_whole_view_is_a_step() -> None:
    assert choose_frames([0.0, 5 * STEP, 0.0, 5 * STEP], [1.0] * 4, ()) == [0, 1, 3]


def test_no_frame_is_left_out_beside_a_step_that_is_not_known() -> None:
    steps = [0.0, *[STEP / 4] * 7, np.nan, *[STEP / 4] * 9]
    assert {7, 8} <= set(choose_frames(steps, [1.0] * 18, ()))
    steps[8] = STEP
    assert 7 not in choose_frames(steps, [1.0] * 18, ())


def test_motion_is_not_known_where_nothing_is_found_again() -> None:
    rng = np.random.default_rng(1)
    meter = MotionMeter.start()
    for _ in range(2):
        meter.add(np.kron(rng.integers(0, 255, (30, 40)), np.ones((8, 8))).astype(np.uint8))
    meter.add(np.zeros((120, 320), np.uint8))
    assert np.isnan(meter.steps[2])


@pytest.mark.parametrize("is_long", [True, False])
def test_faint_features_of_plain_walls_count_in_a_long_sequence(is_long: bool) -> None:
    rng = np.random.default_rng(4)
    coarse = cv2.resize(rng.normal(0, 5, (48, 64)), (640, 480), interpolation=cv2.INTER_CUBIC)
    wall = np.rint(180 + coarse).astype(np.uint8)
    extractor = create_extractor("sift-full")
    plain = extractor.extract(wall)
    assert len(plain) < matches.OPTIONS.few_features
    found = features_of(wall, extractor, is_long=is_long)
    assert (len(found) > 2 * len(plain) + 50) is is_long


def test_a_long_video_gets_longer_steps() -> None:
    count = 3 * motion.OPTIONS.max_frames
    chosen = choose_frames([0.0, *[STEP] * (count - 1)], [1.0] * count, ())
    assert len(chosen) < 1.7 * motion.OPTIONS.max_frames


def test_motion_is_a_share_of_the_longer_side() -> None:
    rng = np.random.default_rng(0)
    wide = np.kron(rng.integers(0, 255, (30, 60)), np.ones((8, 8))).astype(np.uint8)
    meter = MotionMeter.start()
    meter.add(wide[:, :320])
    meter.add(wide[:, 16:336])
    assert meter.steps == [0.0, pytest.approx(16 / 320, rel=0.1)]


def test_few_pictures_are_all_compared_and_many_with_neighbours_and_look_alikes() -> None:
    rng = np.random.default_rng(0)
    count = 4 * matches.OPTIONS.all_pairs_up_to
    descriptors = rng.normal(size=(count, 32)).astype(np.float32)
    descriptors[count - 3] = descriptors[2]
    few = pairs_to_compare(descriptors[:10], is_sequence=False)
    assert len(few) == 45
    pairs = pairs_to_compare(descriptors, is_sequence=True)
    assert (2, count - 3) in pairs
    assert all((i, i + 1) in pairs for i in range(count - 1))
    assert len(pairs) == len(set(pairs)) < count * (count - 1) / 4
    assert all(i < j for i, j in pairs)
