"""One cube seen by a camera of each convention: at the same pixels, which are those of Roomfix's own camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from app.api.requests.axes import CONVENTIONS, NAMES, AxesName
from app.cli import app
from app.geometry.camera import Camera
from bench.axes.cube import (
    DIRECTIONS,
    FOCAL_PX,
    HEIGHT_PX,
    WIDTH_PX,
    camera_pose,
    corners_m,
    pixels_of,
    points_in,
    seen_by,
)
from bench.axes.picture import PANELS

TOLERANCE_PX = 1e-9


@pytest.mark.parametrize("name", NAMES)
def test_the_corners_are_where_the_camera_sees_them(name: AxesName) -> None:
    centre = ((WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2)
    camera = Camera("PINHOLE", WIDTH_PX, HEIGHT_PX, (FOCAL_PX, FOCAL_PX, *centre))
    pose = camera_pose()
    in_camera = (corners_m() - pose.translation) @ pose.rotation
    expected = camera.project(in_camera)
    found = pixels_of(name, corners_m())
    assert np.abs(found - expected).max() < TOLERANCE_PX
    assert ((found > 0) & (found < [WIDTH_PX, HEIGHT_PX])).all()


def test_a_pose_of_another_convention_is_seen_elsewhere() -> None:
    points = points_in("arkit", corners_m())
    wrong = seen_by("arkit", points, CONVENTIONS["unity"].pose_out(camera_pose()))
    assert np.abs(wrong - pixels_of("arkit", corners_m())).max() > 10


def test_every_convention_has_a_panel_or_is_like_one_that_has() -> None:
    shown = [name for name, _ in PANELS]
    for name in NAMES:
        alike = [
            other
            for other in shown
            if DIRECTIONS[other] == DIRECTIONS[name]
            and np.array_equal(CONVENTIONS[other].world, CONVENTIONS[name].world)
        ]
        assert len(alike) == 1


def test_the_picture_is_written(tmp_path: Path) -> None:
    picture = tmp_path / "axes.png"
    result = CliRunner().invoke(app, ["plot-axes", str(picture)])
    assert result.exit_code == 0, result.output
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert CliRunner().invoke(app, ["plot-axes", str(tmp_path / "axes.jpg")]).exit_code != 0
