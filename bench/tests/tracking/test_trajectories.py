"""Trajectories of other programs, read and compared with the true path."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.errors import InvalidInputError
from app.geometry.se3 import Pose, rotation_from_vector
from bench.tracking.sequences import TrackedFrame
from bench.tracking.trajectories import compare_tracked, compare_trajectory, read_trajectory


class Seen:
    """A frame of a video, with what a comparison looks at."""

    def __init__(self, time_s: float, place: np.ndarray) -> None:
        self.timestamp_s = time_s
        self.scan_from_camera = Pose(np.eye(3), place)


@pytest.fixture
def video() -> list[Any]:
    rng = np.random.default_rng(3)
    places = np.cumsum(rng.uniform(-0.1, 0.2, (40, 3)), axis=0)
    return [Seen(100.0 + 0.1 * k, place) for k, place in enumerate(places)]


def written(
    path: Path, video: list[Any], scale: float = 1.0, noise_m: float = 0.0, late_s: float = 0.0
) -> Path:
    """Write a trajectory in axes and a scale of its own, in TUM's format."""
    turn, shift = rotation_from_vector(np.array([0.2, -0.4, 1.1])), np.array([3.0, -2.0, 0.7])
    rng = np.random.default_rng(4)
    lines = ["# timestamp tx ty tz qx qy qz qw"]
    for frame in video:
        place = scale * turn @ frame.scan_from_camera.translation + shift + noise_m * rng.standard_normal(3)
        lines.append(f"{frame.timestamp_s + late_s:.6f} " + " ".join(f"{v:.9f}" for v in place) + " 0 0 0 1")
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_trajectory_in_other_axes_and_scale_is_the_same_path(tmp_path: Path, video: list[Any]) -> None:
    path = written(tmp_path / "CameraTrajectory.txt", video, scale=0.5, late_s=0.004)
    as_it_is, scaled = compare_trajectory(path.name, read_trajectory(path), video)
    assert scaled.scale == pytest.approx(2.0, abs=1e-6)
    assert scaled.errors_m.max() < 1e-6
    assert as_it_is.scale is None
    assert as_it_is.errors_m.mean() > 0.1
    assert scaled.frames_percent == 100.0


def test_errors_are_those_of_the_noise_and_frames_without_pose_are_told(
    tmp_path: Path, video: list[Any]
) -> None:
    path = written(tmp_path / "poses.txt", video[:20], noise_m=0.05)
    as_it_is, _ = compare_trajectory("poses", read_trajectory(path), video)
    assert as_it_is.frames_percent == 50.0
    assert np.sqrt(np.mean(as_it_is.errors_m**2)) == pytest.approx(0.05 * np.sqrt(3), rel=0.35)
    assert as_it_is.cells()[:3] == ("poses", "as it is", "50.0")


def test_times_of_another_video_are_no_trajectory(tmp_path: Path, video: list[Any]) -> None:
    path = written(tmp_path / "poses.txt", video, late_s=5000.0)
    with pytest.raises(InvalidInputError, match="0 of 40 frames"):
        compare_trajectory("poses", read_trajectory(path), video)


def test_a_path_along_one_line_is_not_aligned(tmp_path: Path) -> None:
    straight = [Seen(100.0 + k, np.array([0.1 * k, 0.0, 0.0])) for k in range(9)]
    path = tmp_path / "poses.txt"
    path.write_text("\n".join(f"{100 + k} {0.2 * k} 0 0 0 0 0 1" for k in range(9)))
    assert compare_trajectory("poses", read_trajectory(path), straight) == []


def test_a_file_without_times_is_none(tmp_path: Path) -> None:
    path = tmp_path / "kitti.txt"
    path.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 5)
    with pytest.raises(InvalidInputError, match="0 poses with times"):
        read_trajectory(path)


def test_what_was_tracked_here_stands_as_answered_and_aligned(video: list[Any]) -> None:
    def frame(seen: Any, is_found: bool) -> TrackedFrame:
        truth = seen.scan_from_camera.translation
        return TrackedFrame(
            name="", state="", reason=None, error_m=0.0, error_deg=0.0, sigma_m=None, milliseconds=1.0,
            truth=truth.tolist(), position=(truth + np.array([1.0, 0.0, 0.0])).tolist() if is_found else None,
        )  # fmt: skip

    frames = [frame(seen, k % 4 > 0) for k, seen in enumerate(video)]
    answered, aligned, scaled = compare_tracked("Roomfix", frames)
    assert answered.errors_m == pytest.approx(1.0)
    assert aligned.errors_m.max() < 1e-9
    assert scaled.scale == pytest.approx(1.0)
    assert answered.frames_percent == 75.0
    assert compare_tracked("Roomfix", frames[:1]) == []
