"""Evaluations on a scan made by code: extended maps, and queries as phones send them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from app.cli import app
from app.engine.mapping.register_scan import Registration
from app.errors import InvalidInputError
from app.geometry.camera_hint import hint_of
from app.geometry.se3 import Pose, rotation_from_vector
from app.importers.frames import ScanOptions
from bench.evaluation.extend import moved_scan, other_frame, registration_error, split_for_extension
from tests.scenes import CAMERA, CAMERA_TEXT, Room, pose_at, scan_files

OPTIONS = json.dumps({"camera": CAMERA_TEXT, "gravity": [0, 0, -1]})


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory, room: Room) -> Path:
    """A scan of two rounds past the same corner and a third of queries."""
    folder = tmp_path_factory.mktemp("scan")
    poses = [
        pose_at(1.4 + 0.05 * i + 0.1 * part, 1.3 + 0.1 * part, yaw_deg=-10 + 8.0 * i, pitch_deg=part)
        for part in (0, 1, 0.5)
        for i in range(9)
    ]
    for path, data in scan_files([room.view(pose) for pose in poses]).items():
        (folder / path).parent.mkdir(exist_ok=True)
        (folder / path).write_bytes(data)
    return folder


def run(folder: Path, *arguments: str) -> Any:
    target = folder / "figures.json"
    result = CliRunner().invoke(
        app, [arguments[0], str(folder), *arguments[1:], "--options", OPTIONS, "--json", str(target)]
    )
    assert result.exit_code == 0, result.output
    return json.loads(target.read_text())


def test_a_second_scan_is_registered_and_as_good_as_one_scan(scan: Path) -> None:
    figures = run(
        scan, "evaluate-extend", "--first", "0:9", "--second", "9:18", "--queries", "18:27:4", "--seed", "4"
    )
    assert figures["registration_cm"] < 1.0
    assert figures["registration_deg"] < 0.3
    assert figures["agreeing"] >= 5
    summaries = figures["summaries"]
    assert set(summaries) == {"first scan", "extended", "one scan"}
    assert summaries["extended"]["located_percent"] == 100
    assert summaries["extended"]["median_cm"] < summaries["one scan"]["median_cm"] + 1.0


def test_parts_that_can_not_be_compared_are_refused(scan: Path) -> None:
    options = ScanOptions(camera=hint_of(CAMERA))
    for parts in (("0:9", "8:18", "18:27"), ("0:0", "9:18", "18:27"), ("0:9", "9:18", "0:18")):
        with pytest.raises(InvalidInputError):
            split_for_extension(scan, *parts, "tum", options)


def test_the_moved_scan_is_another_frame(scan: Path) -> None:
    split = split_for_extension(scan, "0:9", "9:18", "18:", "tum", ScanOptions(camera=hint_of(CAMERA)))
    motion = other_frame(1)
    assert 15 <= np.abs(motion.translation).min() <= np.abs(motion.translation).max() <= 30
    moved = moved_scan(split.second, motion)
    assert moved.gravity is None
    truth = motion.inverse()
    assert registration_error(Registration(truth, 1, 1, 1), truth, moved) == pytest.approx((0, 0), abs=1e-6)
    turned = Pose(rotation_from_vector([0, 0, np.radians(1.0)]), np.zeros(3)) @ truth
    off_m, off_deg = registration_error(Registration(turned, 1, 1, 1), truth, moved)
    assert off_deg == pytest.approx(1.0)
    # Two metres from the world's origin, however far the scan's own one is.
    assert 0.02 < off_m < 0.06


def test_queries_as_phones_send_them(scan: Path) -> None:
    cases = {
        c["case"]: c for c in run(scan, "evaluate-phones", "--database", "0:18:2", "--queries", "19:27:5")
    }
    assert {"camera in the request", "search", "EXIF, focal +8 %", "turned 90, with gravity"} <= set(cases)
    assert cases["EXIF, focal +3 %"]["sources"].keys() <= {"exif", "search"}
    for name in ("camera in the request", "turned 90, with gravity", "turned 270, with gravity"):
        assert cases[name]["summary"]["located_percent"] == 100
        assert cases[name]["summary"]["max_cm"] < 3
