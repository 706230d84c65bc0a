"""One style for all plots of a report: colours that colour-blind readers can distinguish, one size, units on axes."""

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

# Okabe and Ito's palette, its yellow left out: too pale for a line on white.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
LINE_STYLES = ("-", "--", ":")
GREY = "#8a8a8a"
DPI = 110
# File formats of pictures.
PLOT_SUFFIXES = (".png", ".svg", ".pdf")


def line_style(number: int) -> tuple[str, str]:
    """Return the colour and the dashes of a report's n-th curve: 21 differ."""
    return PALETTE[number % len(PALETTE)], LINE_STYLES[number // len(PALETTE) % len(LINE_STYLES)]


def new_figure(width_in: float, height_in: float) -> Figure:
    """Return an empty figure in the report's style."""
    return Figure(figsize=(width_in, height_in), layout="constrained")


def label_axes(axes: Axes, x: str, y: str, title: str = "") -> None:
    """Label both axes, quietly grid them, and drop the box."""
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    if title:
        axes.set_title(title, fontsize=10)
    axes.grid(color="#e4e4e4", linewidth=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def save(figure: Figure, path: Path) -> Path:
    """Write the figure as PNG and return where."""
    figure.savefig(path, dpi=DPI)
    return path
