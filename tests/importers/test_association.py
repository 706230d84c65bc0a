"""Pairs by time, and poses between the rows of a trajectory."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.errors import InvalidScanError
from app.geometry.se3 import Pose, attitude_difference_rad, rotation_from_vector
from app.importers.association import Trajectory, associate, slerp

HALF_TURN_Z = [0.0, 0.0, np.sin(0.25), np.cos(0.25)]  # half a radian about z


def pairs(a: list[float], b: list[float], tolerance: float = 0.02) -> list[int]:
    return associate(np.array(a), np.array(b), tolerance).tolist()


def test_each_time_gets_the_nearest() -> None:
    assert pairs([0.0, 0.1, 0.2], [0.205, 0.09, 0.001]) == [2, 1, 0]


def test_the_closest_pair_is_made_first_and_each_entry_once() -> None:
    assert pairs([0.000, 0.010], [0.012]) == [-1, 0]
    # 0.010 is the nearest for both; the closer one has it, the other takes what is left within reach.
    assert pairs([0.000, 0.009], [0.010, -0.015]) == [1, 0]


def test_the_tolerance_itself_is_within() -> None:
    start = 1305031229.5
    assert pairs([start], [start + 0.02]) == [0]
    assert pairs([start], [start + 0.0201]) == [-1]
    assert pairs([1.0], [1.0], 0.0) == [0]
    assert pairs([1.0], [1.001], 0.0) == [-1]
    assert pairs([1.0], []) == [-1]
    assert pairs([], [1.0]) == []


@settings(max_examples=100, deadline=None, derandomize=True)
@given(
    st.lists(st.floats(0, 1, allow_subnormal=False), max_size=25),
    st.lists(st.floats(0, 1, allow_subnormal=False), max_size=25),
)
def test_pairs_are_one_to_one_within_reach_and_none_is_left_out(a: list[float], b: list[float]) -> None:
    partner = pairs(a, b, 0.05)
    taken = [j for j in partner if j >= 0]
    assert len(set(taken)) == len(taken)
    assert all(abs(a[i] - b[j]) <= 0.0501 for i, j in enumerate(partner) if j >= 0)
    free = set(range(len(b))) - set(taken)
    assert not any(abs(a[i] - b[j]) <= 0.05 for i, p in enumerate(partner) if p < 0 for j in free)


def test_times_that_are_all_alike_are_refused_before_they_fill_the_memory() -> None:
    with pytest.raises(InvalidScanError, match="in seconds"):
        pairs([0.0] * 10_000, [0.0] * 10_000)


def trajectory(*rows: list[float]) -> Trajectory:
    return Trajectory.from_rows(np.array(rows))


def pose_at(path: Trajectory, time_s: float) -> Pose:
    pose = path.pose_at(time_s, 0.02)
    assert isinstance(pose, Pose)
    return pose


def test_an_identical_time_takes_the_pose_as_it_is() -> None:
    path = trajectory([0.0, 1, 2, 3, 0, 0, 0, 1], [0.01, 5, 5, 5, *HALF_TURN_Z], [0.02, 9, 9, 9, 0, 0, 0, 1])
    assert pose_at(path, 0.01).translation.tolist() == [5, 5, 5]
    np.testing.assert_allclose(pose_at(path, 0.01).quaternion, HALF_TURN_Z, atol=1e-12)


def test_between_two_rows_the_pose_is_interpolated() -> None:
    path = trajectory([0.0, 0, 0, 0, 0, 0, 0, 1], [0.02, 1, 0, 2, *HALF_TURN_Z])
    pose = pose_at(path, 0.005)
    np.testing.assert_allclose(pose.translation, [0.25, 0, 0.5])
    np.testing.assert_allclose(pose.rotation, rotation_from_vector([0, 0, 0.125]), atol=1e-12)


def test_where_one_row_only_is_within_reach_it_is_taken() -> None:
    path = trajectory([0.0, 0, 0, 0, 0, 0, 0, 1], [1.0, 1, 0, 0, 0, 0, 0, 1])
    assert pose_at(path, 0.015).translation.tolist() == [0, 0, 0]
    assert pose_at(path, 1.015).translation.tolist() == [1, 0, 0]
    assert path.pose_at(0.5, 0.02) == "no_pose"


def test_sparse_rows_are_interpolated_but_never_reach_beyond_their_ends() -> None:
    path = trajectory([0.0, 0, 0, 0, 0, 0, 0, 1], [0.2, 2, 0, 0, 0, 0, 0, 1], [0.6, 6, 0, 0, 0, 0, 0, 1])
    between = path.pose_between(0.15, 0.25, 0.02)
    assert isinstance(between, Pose)
    np.testing.assert_allclose(between.translation, [1.5, 0, 0])
    # Before the first row, in a gap of 0.4 s, and after the last row, a tenth of a second from the nearest each time.
    assert [path.pose_between(time_s, 0.25, 0.02) for time_s in (-0.1, 0.3, 0.7)] == ["no_pose"] * 3
    near = path.pose_between(0.61, 0.25, 0.02)
    assert isinstance(near, Pose)
    assert near.translation.tolist() == [6, 0, 0]


@pytest.mark.parametrize(
    "broken", [[float("nan"), 0, 0, 0, 0, 0, 1], [0, 0, float("inf"), 0, 0, 0, 1], [0] * 7]
)
def test_a_broken_row_is_not_replaced_by_its_neighbours(broken: list[float]) -> None:
    path = trajectory([0.0, 0, 0, 0, 0, 0, 0, 1], [0.01, *broken], [0.02, 2, 0, 0, 0, 0, 0, 1])
    assert path.valid.tolist() == [True, False, True]
    assert path.pose_at(0.01, 0.02) == "invalid_pose"
    assert path.pose_at(0.009, 0.02) == "invalid_pose"
    assert pose_at(path, 0.003).translation.tolist() == [0, 0, 0]


def test_rows_in_any_order_with_repetitions() -> None:
    path = trajectory([0.2, 2, 0, 0, 0, 0, 0, 2], [0.1, 1, 0, 0, 0, 0, 0, 2], [0.2, 7, 0, 0, 0, 0, 0, 2])
    assert path.times_s.tolist() == [0.1, 0.2]
    assert pose_at(path, 0.2).translation.tolist() == [2, 0, 0]


def test_slerp_takes_the_shorter_arc_at_constant_speed() -> None:
    a, b = np.array([0.0, 0, 0, 1]), np.array(HALF_TURN_Z)
    for share in (0.0, 0.3, 1.0):
        for end in (b, -b):
            q = slerp(a, end, share)
            turned = attitude_difference_rad(Pose.identity(), Pose.from_quaternion([0, 0, 0], q))
            assert turned == pytest.approx(0.5 * share, abs=1e-9)
    np.testing.assert_allclose(slerp(a, a, 0.4), a)
