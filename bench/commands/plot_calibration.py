"""`roomfix plot-calibration`: the picture of a calibration from the figures that `roomfix calibrate --json` wrote."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from app.engine.mapping.calibration_curves import Calibration
from app.errors import InvalidInputError
from app.vision.keyframes import ATTITUDE_CURVE, POSITION_CURVE
from bench.figures.shown import FiguresTitle, Shown
from bench.reports.calibration_plot import calibration_from_dict, draw_calibration
from bench.reports.plot_style import PLOT_SUFFIXES


def plot_calibration(
    figures: Annotated[
        Path, typer.Argument(exists=True, dir_okay=False, help="What calibrate --json wrote.")
    ],
    plot: Annotated[Path, typer.Argument(help="The picture to write: .png, .svg or .pdf.")],
    title: Annotated[str | None, typer.Option(help="Title of the plot.")] = None,
    figures_title: FiguresTitle = None,
) -> None:
    """Draw the pairs of a calibration, both fitted curves and their thresholds, the paper's curves beside them."""
    if plot.suffix.lower() not in PLOT_SUFFIXES:
        raise InvalidInputError(f"{plot} must end in one of {', '.join(PLOT_SUFFIXES)}.")
    calibration = calibration_from_dict(json.loads(figures.read_text(encoding="utf-8")))
    draw_calibration(calibration, title or figures.stem, plot)
    if figures_title is not None:
        shown = Shown()
        shown.table(_table(calibration))
        shown.write("calibrate", figures_title)


def _table(calibration: Calibration) -> Table:
    table = Table("curve", "a", "b", "RMSE fit", "RMSE validation", "threshold", "paper's threshold")
    for name, unit, fitted, paper in (
        ("position", "m", calibration.position, POSITION_CURVE),
        ("attitude", "rad", calibration.attitude, ATTITUDE_CURVE),
    ):
        validation = "-" if fitted.rmse_validation is None else f"{fitted.rmse_validation:.1f}"
        table.add_row(
            name,
            f"{fitted.curve.a:.4g}",
            f"{fitted.curve.b:.4g}",
            f"{fitted.rmse_fit:.1f}",
            validation,
            f"{fitted.threshold:.4f} {unit}",
            f"{paper.inverse(calibration.wanted_matches):.4f} {unit}",
        )
    return table
