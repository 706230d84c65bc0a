"""The figures of the thesis's experiments: errors of pairs, times by stage, sessions by frame rate."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from app.cli import app
from bench.anchors.pairs import AnchorOutcome
from bench.anchors.starts import Start, StartedFrame
from bench.anchors.thesis import thesis_describer
from bench.figures.shown import report_table
from bench.thesis.figures import error_figures, experiment_table
from bench.thesis.frame_rate import frame_rate_table, rate_figures
from bench.thesis.latency import StageTime, latency_table

PAIR: Any = SimpleNamespace(name="pair")


def outcome(error_m: float) -> AnchorOutcome:
    located = AnchorOutcome(
        pair=PAIR, error_m=error_m, reason=None, position_sigma_m=0.1, confidence=1.0, inliers=9
    )
    return located if math.isfinite(error_m) else replace(located, reason="no_match")


def test_errors_are_those_of_located_phones_and_shares_those_of_all() -> None:
    figures = error_figures([outcome(error) for error in (0.2, 0.4, 3.0, math.inf)])
    assert (figures.pairs, figures.located_percent, figures.good_percent) == (4, 75.0, 50.0)
    assert figures.mean_m == 1.2
    assert figures.median_m == 0.4
    assert figures.variance_m2 == pytest.approx(np.var([0.2, 0.4, 3.0]), abs=1e-4)
    assert figures.p90_m == pytest.approx(2.48)
    assert figures.wrong_percent == pytest.approx(33.3)


def test_a_row_where_nothing_is_located_has_no_errors() -> None:
    rows = {("60 deg", "thesis"): error_figures([outcome(math.inf)])}
    cells = report_table(experiment_table("angle", rows)).rows[0]
    assert cells == ("60 deg", "thesis", "1", "0", "-", "-", "-", "-", "0", "-")


def test_a_stage_of_one_pipeline_has_its_times_at_each_setting() -> None:
    times = {
        "thesis": {"720": {"akaze": StageTime(21.0, 3.0)}, "1080": {"akaze": StageTime(31.04, 6.0)}},
        "default": {"720": {"xfeat": StageTime(5.0, 1.0)}, "1080": {}},
    }
    table = report_table(latency_table(times))
    assert list(table.rows) == [
        ("thesis", "akaze", "21.0", "3.0", "31.0", "6.0"),
        ("default", "xfeat", "5.0", "1.0", "-", "-"),
    ]


def test_sessions_are_told_by_their_frames_and_their_ends() -> None:
    frames = (StartedFrame(0.0, 0.1, 0.05), StartedFrame(0.8, 0.3, 0.05))
    figures = rate_figures(
        [Start("a", frames, None, None, 0.1), Start("b", frames[:1], None, None, 0.1), "lost"]
    )
    assert (figures.sessions, figures.went_on) == (3, 2)
    assert (figures.path_m, figures.last_m) == (0.4, 0.2)
    assert figures.mean_m == pytest.approx(0.167)
    cells = report_table(frame_rate_table({(60.0, "thesis"): rate_figures(["lost"])})).rows[0]
    assert cells == ("60", "thesis", "1", "0", "-", "-", "-", "-", "-")


def test_the_thesis_sees_all_pixels_and_all_features() -> None:
    noise = np.random.default_rng(1).integers(0, 256, (108, 192), dtype=np.uint8)
    gray = np.kron(noise, np.ones((10, 10), np.uint8))
    features = thesis_describer().akaze.extract(gray)
    assert len(features.keypoints_px) > 1000
    assert features.keypoints_px[:, 0].max() > 1280


def test_an_experiment_that_is_none_is_said(tmp_path: Any) -> None:
    found = CliRunner().invoke(app, ["evaluate-thesis", str(tmp_path), "--experiment", "weather"])
    assert found.exit_code == 2
    assert "weather" in found.output
