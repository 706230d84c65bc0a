"""Bursts of an evaluation: which frames they have, and the single frames beside them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from app.cli import app
from app.errors import InvalidInputError
from app.geometry.se3 import Pose, position_difference_m
from app.importers.frames import Frame
from bench.bursts.frames import bursts, noisy_motion
from tests.scenes import pose_at


def frame(time_s: float) -> Frame:
    return Frame(f"{time_s:.2f}.png", time_s, Path("0.png"), Path("0.png"), Pose.identity())


FRAMES = [frame(k / 10) for k in range(10)]


def test_a_burst_has_the_frames_nearest_to_the_wanted_times() -> None:
    found = bursts([FRAMES[1], FRAMES[4]], [each for each in FRAMES if each is not FRAMES[3]], 3, 0.2)
    # Frame 3 is the map's: of its neighbours one is taken.
    assert found[0][0].name == "0.10.png"
    assert found[0][1].name in ("0.20.png", "0.40.png")
    assert [each.name for each in found[1]] == ["0.40.png", "0.60.png", "0.80.png"]


def test_a_query_that_ends_the_scan_has_no_burst() -> None:
    assert len(bursts([FRAMES[1], FRAMES[8]], FRAMES, 3, 0.2)) == 1
    with pytest.raises(InvalidInputError, match="No query is followed"):
        bursts([FRAMES[8]], FRAMES, 3, 0.2)


def test_the_error_of_a_motion_is_that_of_odometry_and_always_the_same() -> None:
    motion = pose_at(0.3, 0.1, 0.0, 10.0)
    errors = [position_difference_m(noisy_motion(motion, str(seed)), motion) for seed in range(200)]
    length_m = float(np.linalg.norm(motion.translation))
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(0.02 * length_m, rel=0.15)
    np.testing.assert_array_equal(noisy_motion(motion, "a").matrix, noisy_motion(motion, "a").matrix)


def test_bursts_stand_beside_their_first_frames(scan: Path, tmp_path: Path) -> None:
    file = tmp_path / "bursts.json"
    given = ["evaluate", str(scan), "--database", "0:14", "--queries", "14:", "--burst", "2"]
    given += ["--apart-s", "0.1", "--json", str(file)]
    result = CliRunner().invoke(app, given, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    rows = json.loads(file.read_text())
    assert [row["variation"] for row in rows] == [
        "none, 1 frame",
        "none, 2 frames",
        "none, 2 frames, no motion",
    ]
    for row in rows:
        assert row["summary"]["queries"] == 3
        assert row["summary"]["within_10cm_5deg_percent"] == 100.0
    names = [[outcome["name"] for outcome in row["outcomes"]] for row in rows]
    assert names == [names[0]] * 3
    assert "normal error of 2%" in " ".join(result.output.split())
