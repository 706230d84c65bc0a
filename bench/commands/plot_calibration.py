"""`roomfix plot-calibration`: the picture of a calibration from the figures that `roomfix calibrate --json` wrote."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from app.errors import InvalidInputError
from bench.reports.calibration_plot import calibration_from_dict, draw_calibration
from bench.reports.plot_style import PLOT_SUFFIXES


def plot_calibration(
    figures: Annotated[
        Path, typer.Argument(exists=True, dir_okay=False, help="What calibrate --json wrote.")
    ],
    plot: Annotated[Path, typer.Argument(help="The picture to write: .png, .svg or .pdf.")],
    title: Annotated[str | None, typer.Option(help="Title of the plot.")] = None,
) -> None:
    """Draw the pairs of a calibration, both fitted curves and their thresholds, the paper's curves beside them."""
    if plot.suffix.lower() not in PLOT_SUFFIXES:
        raise InvalidInputError(f"{plot} must end in one of {', '.join(PLOT_SUFFIXES)}.")
    calibration = calibration_from_dict(json.loads(figures.read_text(encoding="utf-8")))
    draw_calibration(calibration, title or figures.stem, plot)
