"""The picture of cumulative errors: which share of the queries is located better than what."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from bench.evaluation.pose_errors import QueryOutcome

NEAREST_M = 1e-3
FARTHEST_M = 10.0


def draw_cumulative(curves: Mapping[str, Sequence[QueryOutcome]], title: str, path: Path) -> None:
    """Write the curves, one for each name; the suffix of the path says as what (PNG, SVG, PDF).

    Shares are of all queries, so a curve ends where the rest is not located.
    """
    figure = Figure(figsize=(7.5, 4.6), layout="constrained")
    axes = figure.subplots()
    for name, outcomes in curves.items():
        errors = np.sort([outcome.position_m for outcome in outcomes if outcome.located])
        shares = 100.0 * np.arange(1, len(errors) + 1) / max(len(outcomes), 1)
        ends = np.append(errors, FARTHEST_M), np.append(shares, shares[-1:] if len(shares) else [0.0])
        axes.step(*ends, where="post", linewidth=1.8, label=name)
    axes.axvline(1.0, color="#8a8a8a", linewidth=0.8, linestyle=":")
    axes.set_xscale("log")
    axes.set_xlim(NEAREST_M, FARTHEST_M)
    axes.set_ylim(0, 101)
    axes.set_xlabel("position error (m)")
    axes.set_ylabel("queries (%)")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=9, loc="lower right")
    axes.set_title(title)
    figure.savefig(path, dpi=110)
