"""The picture of a calibration, drawn from the figures that `roomfix calibrate --json` wrote."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from app.cli import app
from app.engine.mapping.calibration_curves import PairCounts, fit_curves
from app.vision.keyframes import ATTITUDE_CURVE, POSITION_CURVE
from bench.reports.calibration_plot import calibration_from_dict


@pytest.fixture
def figures(tmp_path: Path) -> Path:
    """The figures of pairs that follow the paper's curves."""
    generator = np.random.default_rng(3)
    position = generator.uniform(0.02, 0.6, 400)
    attitude = generator.uniform(0.02, 0.5, 400)
    matches = np.minimum(POSITION_CURVE(position), ATTITUDE_CURVE(attitude)).astype(np.int64)
    counts = PairCounts(position, attitude, matches, generator.random(400) < 0.3)
    path = tmp_path / "figures.json"
    path.write_text(json.dumps(fit_curves(counts, 50.0, "orb", 100).as_dict()))
    return path


def test_figures_are_read_back(figures: Path) -> None:
    written = json.loads(figures.read_text())
    assert calibration_from_dict(written).as_dict() == written


def test_the_picture_is_written(figures: Path, tmp_path: Path) -> None:
    picture = tmp_path / "plot.png"
    result = CliRunner().invoke(app, ["plot-calibration", str(figures), str(picture)])
    assert result.exit_code == 0, result.output
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(("content", "name"), [("{}", "plot.png"), (None, "plot.exe")])
def test_what_cannot_be_drawn_is_refused(
    figures: Path, tmp_path: Path, content: str | None, name: str
) -> None:
    if content is not None:
        figures.write_text(content)
    assert CliRunner().invoke(app, ["plot-calibration", str(figures), str(tmp_path / name)]).exit_code != 0
