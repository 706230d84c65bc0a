"""Poses written another way, and read back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from app.errors import InvalidInputError
from app.geometry.camera_hint import hint_of
from app.geometry.se3 import Pose, rotation_from_vector
from app.importers.conventions import ALL_AXES, PoseArrays, PoseConvention, parse_axes
from app.importers.frames import ScanOptions
from app.importers.registry import open_scan
from tests.scenes import CAMERA, View, scan_files


def some_poses(count: int = 5) -> PoseArrays:
    rng = np.random.default_rng(3)
    return PoseArrays.of(
        [Pose(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3)) for _ in range(count)]
    )


@pytest.mark.parametrize("axes", ["rdf", "rub", "flu", "ruf", "ldf"])
@pytest.mark.parametrize("poses", ["world_from_camera", "camera_from_world", "rotation_transposed"])
@pytest.mark.parametrize("quaternion", ["xyzw", "wxyz"])
def test_what_is_written_is_read_back(axes: str, poses: str, quaternion: str) -> None:
    convention = PoseConvention(
        axes=axes,
        poses=poses,  # type: ignore[arg-type]
        quaternion=quaternion,  # type: ignore[arg-type]
        rotate_deg=90,
        position_scale=100.0,
        mount_deg=(3.0, -4.0, 5.0),
    )
    right = some_poses()
    again = convention.read(convention.written(right))
    assert again.rotations == pytest.approx(right.rotations, abs=1e-9)
    assert again.positions == pytest.approx(right.positions, abs=1e-9)
    assert np.linalg.det(convention.written(right).rotations) == pytest.approx(1.0)


def test_axes_of_opengl_turn_y_and_z() -> None:
    right = some_poses(1)
    written = PoseConvention(axes="rub").written(right)
    assert written.rotations[0] == pytest.approx(right.rotations[0] @ np.diag([1, -1, -1]))
    assert written.positions == pytest.approx(right.positions)


def test_a_left_handed_world_whose_y_is_up_gets_z_up() -> None:
    unity = PoseConvention(axes=parse_axes("Unity"))
    assert unity.is_left_handed
    assert unity.direction_in_own((0.0, -1.0, 0.0)) == (0.0, 0.0, -1.0)
    # A camera that looks along Unity's z, upright at the origin: its lower side points down.
    level = unity.read(PoseArrays(np.eye(3)[None], np.zeros((1, 3))))
    assert level.rotations[0][:, 1] == pytest.approx([0, 0, -1])


def test_there_are_48_axes() -> None:
    assert len(set(ALL_AXES)) == 48


@pytest.mark.parametrize(
    "wrong",
    [
        {"axes": "rrf"},
        {"axes": "up"},
        {"rotate_deg": 45},
        {"position_scale": 0.0},
        {"time_offset_s": 1e9},
        {"mount_deg": (0, 0, 400)},
    ],
)
def test_what_cant_be_meant_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(InvalidInputError):
        PoseConvention(**wrong)  # type: ignore[arg-type]


def test_poses_are_taken_at_another_time(views: list[View], tmp_path: Path) -> None:
    for name, data in scan_files(views).items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    options = ScanOptions(camera=hint_of(CAMERA), convention=PoseConvention(time_offset_s=0.1))
    scan = open_scan(tmp_path, "tum", options)
    assert len(scan.frames) == len(views) - 1
    for frame, view in zip(scan.frames, views[1:], strict=True):
        assert frame.scan_from_camera.translation == pytest.approx(
            view.world_from_camera.translation, abs=1e-6
        )
    between = ScanOptions(camera=hint_of(CAMERA), convention=PoseConvention(time_offset_s=0.05))
    first = open_scan(tmp_path, "tum", between).frames[0].scan_from_camera.translation
    middle = 0.5 * (views[0].world_from_camera.translation + views[1].world_from_camera.translation)
    assert first == pytest.approx(middle, abs=1e-6)
