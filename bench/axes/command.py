"""`roomfix plot-axes`: the picture of one cube in the axes of each AR framework."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from app.errors import InvalidInputError
from bench.axes.picture import draw_axes
from bench.reports.plot_style import PLOT_SUFFIXES


def plot_axes(
    plot: Annotated[Path, typer.Argument(help="The picture to write: .png, .svg or .pdf.")],
) -> None:
    """Draw one cube as a camera of each convention of axes sees it."""
    if plot.suffix.lower() not in PLOT_SUFFIXES:
        raise InvalidInputError(f"{plot} must end in one of {', '.join(PLOT_SUFFIXES)}.")
    draw_axes(plot)
