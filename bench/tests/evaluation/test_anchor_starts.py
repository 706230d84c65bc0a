"""Sessions that an anchor starts, evaluated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from app.engine.anchors.features import AnchorDescriber
from app.importers.frames import ScanOptions
from app.importers.registry import open_scan
from bench.anchors.pairs import PairEvaluator
from bench.anchors.starts import (
    Start,
    StartedFrame,
    StartSettings,
    evaluate_starts,
    growth_rows,
    summarize_starts,
)

REDKITCHEN = Path(__file__).parents[4] / "shared" / "data" / "redkitchen"


class Silent:
    """No progress."""

    def report(self, stage: str, done: int, total: int) -> None:
        """Say nothing."""


def test_figures_tell_scale_and_growth() -> None:
    frames = (StartedFrame(0.0, 0.02, 0.05), StartedFrame(0.6, 0.5, 0.1))
    outcomes: list[Start | str] = [
        Start("a", frames, 1.04, 1.0, 0.05),
        Start("b", frames[:1], None, 0.1, 0.05),
        "no_match",
    ]
    figures = summarize_starts(outcomes)
    assert (figures["starts"], figures["located"], figures["reasons"]) == (3, 2, {"no_match": 1})
    assert figures["scale off by, median %"] == 4.0
    assert figures["scale within 5 %, % of them"] == 100.0
    assert growth_rows([each for each in outcomes if isinstance(each, Start)]) == [
        ["0-0.25", "2", "2.0", "2.0", "5.0", "100.0"],
        ["0.5-1", "1", "50.0", "50.0", "10.0", "0.0"],
    ]
    assert summarize_starts(["no_match"])["scale within 5 %, % of them"] is None


@pytest.mark.skipif(not REDKITCHEN.is_dir(), reason="the real scan is not here")
def test_a_monitoring_frame_starts_sessions_on_real_frames() -> None:
    scan = open_scan(REDKITCHEN, None, ScanOptions())
    outcomes = evaluate_starts(
        scan,
        scan.frames[:300],
        scan.frames[300:500],
        np.array([0.017715, 0.913855, 0.405653]),
        StartSettings(starts=3, frames=8, anchored=4, pois=2),
        PairEvaluator(AnchorDescriber()),
        Silent(),
    )
    started = [outcome for outcome in outcomes if isinstance(outcome, Start)]
    assert started, outcomes
    for start in started:
        assert start.frames[0].error_m < 4 * start.frames[0].sigma_m
