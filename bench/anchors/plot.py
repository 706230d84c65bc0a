"""Pictures of an evaluation of anchors: error and located rate by angle, by distance and by condition."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bench.anchors.pairs import AnchorOutcome, AnchorSummary

BAR_COLOR = "#4c78a8"
ERROR_COLOR = "#f58518"


def draw_summaries(tables: Mapping[str, Mapping[str, AnchorSummary]], title: str, path: Path) -> None:
    """Write one panel for each table: bars of the located share, and the mean error as dots."""
    figure = Figure(figsize=(4.6 * len(tables), 4.2), layout="constrained")
    for axes, (name, rows) in zip(
        np.atleast_1d(figure.subplots(1, len(tables))), tables.items(), strict=True
    ):
        _panel(axes, name, rows)
    figure.suptitle(title)
    figure.savefig(path, dpi=110)


def draw_errors(outcomes: Mapping[str, list[AnchorOutcome]], title: str, path: Path) -> None:
    """Write the cumulative share of all pairs over the error."""
    figure = Figure(figsize=(6, 4.2), layout="constrained")
    axes = figure.subplots()
    for name, group in outcomes.items():
        errors = np.sort([outcome.error_m for outcome in group])
        axes.step(errors, 100 * np.arange(1, len(errors) + 1) / len(errors), where="post", label=name)
    axes.set_xlim(0, 1.5)
    axes.set_ylim(0, 100)
    axes.set_xlabel("position error (m)")
    axes.set_ylabel("share of all pairs (%)")
    axes.legend(fontsize=8)
    axes.set_title(title)
    figure.savefig(path, dpi=110)


def _panel(axes: Axes, name: str, rows: Mapping[str, AnchorSummary]) -> None:
    x = np.arange(len(rows))
    axes.bar(x, [summary.located_percent for summary in rows.values()], color=BAR_COLOR, width=0.6)
    axes.set_ylim(0, 100)
    axes.set_ylabel("located (%)")
    axes.set_xticks(x, list(rows), rotation=30, ha="right", fontsize=8)
    axes.set_title(name)
    right = axes.twinx()
    means = [np.nan if summary.mean_m is None else summary.mean_m for summary in rows.values()]
    right.plot(x, means, "o", color=ERROR_COLOR)
    right.set_ylim(0, max(0.5, 1.2 * float(np.nanmax([*means, 0.0]))))
    right.set_ylabel("mean error (m)", color=ERROR_COLOR)
