"""Every equation of app/geometry/README.md is reached by a pipeline that a command runs, not by tests alone."""

from __future__ import annotations

import importlib
import json
import re
import shutil
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import app.geometry
from app.cli import app as cli
from app.engine.mapping.calibration_curves import PairCounts, fit_curves
from tests.scenes import CAMERA, Room, pose_at, scan_files

README = Path(app.geometry.__file__).with_name("README.md")
ROW = re.compile(r"^\| ([ABC] [\d.\-]+) \|.*`(app\.[\w.]+):([\w.]+)` \|$", re.MULTILINE)
# The walk of the scan looks sideways: gravity is down in a frame whose z is up.
PAIRS = ("--gravity", "0,0,-1", "--pipeline", "thesis")
MOTION = {"start": [1.4, 1.3, 1.4], "speed_m_s": 0.9, "direction_deg": 26.0, "fps": 10.0}
IDENTITY = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]


@contextmanager
def called_code() -> Iterator[set[CodeType]]:
    """Collect the code of every function that is called, on this thread and on those that it starts."""
    called: set[CodeType] = set()

    def note(frame: FrameType, event: str, _argument: Any) -> None:
        if event == "call":
            called.add(frame.f_code)

    sys.setprofile(note)
    threading.setprofile(note)
    try:
        yield called
    finally:
        sys.setprofile(None)
        threading.setprofile(None)


def code_of(module: str, name: str) -> CodeType:
    found: Any = importlib.import_module(module)
    for part in name.split("."):
        found = getattr(found, part)
    code: CodeType = getattr(found, "fget", found).__code__
    return code


def run(*arguments: object) -> None:
    result = CliRunner().invoke(cli, [str(each) for each in arguments])
    if result.exception is not None:
        raise result.exception


def without_truth(scan: Path, folder: Path) -> Path:
    """Return a copy of the scan that has no poses, as a walk at constant speed is recorded."""
    shutil.copytree(scan, folder, ignore=shutil.ignore_patterns("groundtruth.txt"))
    return folder


def walk_aside(folder: Path) -> Path:
    """Write a scan of a walk along one wall: its first frames see as monitoring cameras what the others see."""
    room = Room()
    poses = [pose_at(1.2 + 0.15 * i, 1.0, yaw_deg=75.0 + 3.0 * i) for i in range(10)]
    for name, data in scan_files([room.view(pose) for pose in poses]).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    numbers = " ".join(f"{value:g}" for value in CAMERA.params)
    (folder / "camera.txt").write_text(f"PINHOLE {CAMERA.width} {CAMERA.height} {numbers}\n")
    return folder


@pytest.fixture(scope="module")
def called(scan: Path, tmp_path_factory: pytest.TempPathFactory) -> set[CodeType]:
    """The code that the papers' pipelines run: A's and B's on one scan, C's on pairs and sessions of it."""
    folder = tmp_path_factory.mktemp("reached")
    split = "--database", "0:14", "--queries", "14:"
    content = json.dumps({"keyframes": {"rule": "content"}, "world_from_scan": IDENTITY})
    moving = json.dumps({**MOTION, "keyframes": {"rule": "distance", "every_m": 0.1}})
    rng = np.random.default_rng(3)
    differences = rng.uniform(0.02, 0.5, 400)
    matches = (20 * differences**-0.6).astype(np.int64)
    curves = fit_curves(
        PairCounts(differences, differences, matches, rng.random(400) < 0.3), 50.0, "orb", 100
    )
    (folder / "curves.json").write_text(json.dumps(curves.as_dict()))
    aside = walk_aside(folder / "aside")
    with called_code() as called:
        run("evaluate", scan, "--protocol", "keyframes", "--pipeline", "paper")
        run("evaluate", scan, *split, "--options", content, "--pipeline", "vdm", "--pipeline", "epipolar")
        run("evaluate", without_truth(scan, folder / "walk"), *split, "--options", moving)
        run("plot-calibration", folder / "curves.json", folder / "curves.png")
        run("evaluate-anchors", aside, *PAIRS, "--count", "20", "--hard", "0", "--no-compare-features")
        run(
            "track-anchors", aside, *PAIRS, "--monitors", "0:4", "--frames", "4:", "--starts", "2",
            "--length", "5", "--anchored", "2", "--anywhere",
        )  # fmt: skip
    return called


@pytest.mark.parametrize(("equation", "module", "name"), ROW.findall(README.read_text(encoding="utf-8")))
def test_a_pipeline_reaches_the_equation(
    called: set[CodeType], equation: str, module: str, name: str
) -> None:
    assert code_of(module, name) in called, f"{equation}: no command that ran calls {module}:{name}"


def test_a_function_that_no_pipeline_calls_is_noticed(called: set[CodeType]) -> None:
    assert code_of("app.geometry.lines", "point_least_squares_to_lines") not in called
