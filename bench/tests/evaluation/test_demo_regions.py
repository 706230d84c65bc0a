"""Regions of the demonstration: pictures located on another floor are counted."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.engine.mapping.options import BuildOptions
from app.engine.progress import NoProgress
from app.engine.query.settings import LocalizerSettings
from app.geometry.se3 import Pose
from app.importers.frames import ScanOptions
from app.services.resources import open_models
from app.settings import Settings
from bench.commands.evaluate_demo import RegionFigures, evaluate_region
from bench.demo import DemoQuery
from bench.evaluation.dataset import split_scan
from bench.evaluation.run import build
from tests.scenes import CAMERA, View

UPPER_FLOOR_M = 3.5


@pytest.fixture(scope="module")
def upper(scan: Path, queries: list[View]) -> RegionFigures:
    """A room that was mapped a floor too high, but for one picture whose truth is there as well."""
    lifted = Pose(np.eye(3), np.array([0.0, 0.0, UPPER_FLOOR_M]))
    split = split_scan(scan, "0:14", "14:", "auto", ScanOptions())
    with ThreadPoolExecutor(2) as executor:
        built = build(
            "lifted", split, replace(BuildOptions(), world_from_scan=lifted), LocalizerSettings(),
            open_models(Settings(_env_file=None)), executor, NoProgress(),
        )  # fmt: skip
    asked = [
        DemoQuery(
            name=frame.name,
            path=frame.color,
            camera=CAMERA,
            world_from_camera=view.world_from_camera,
            room="",
            floor=0,
        )
        for frame, view in zip(split.queries, queries, strict=True)
    ]
    asked[0] = replace(asked[0], world_from_camera=lifted @ asked[0].world_from_camera, floor=1)
    return evaluate_region("lifted", built.localizer, asked, NoProgress())


def test_each_picture_on_another_floor_is_counted(upper: RegionFigures) -> None:
    assert upper.evaluation.summary.located_percent == 100.0
    assert upper.wrong_floor == 3
    assert upper.evaluation.summary.over_1m_percent == 75.0


def test_the_errors_are_those_of_the_pictures(upper: RegionFigures) -> None:
    right, *wrong = upper.evaluation.outcomes
    assert right.position_m < 0.05
    assert [outcome.position_m for outcome in wrong] == pytest.approx([UPPER_FLOOR_M] * 3, abs=0.05)
