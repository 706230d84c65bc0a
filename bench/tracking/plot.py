"""The picture of a tracked video: where it went, where it truly went, and how far off it was."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from bench.tracking.sequences import TrackedFrame

TRUTH_COLOR = "#8a8a8a"
TRACKED_COLOR = "#4c78a8"
SIGMA_COLOR = "#b9cbe0"
LOST_COLOR = "#e45756"


def draw_tracking(frames: Sequence[TrackedFrame], title: str, path: Path) -> None:
    """Write the plot; the suffix of the path says as what (PNG, SVG, PDF)."""
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    truth = np.array([frame.truth for frame in frames])
    nothing = [np.nan] * 3
    tracked = np.array([nothing if frame.position is None else frame.position for frame in frames])
    left.plot(truth[:, 0], truth[:, 1], color=TRUTH_COLOR, linewidth=3, label="truth")
    left.plot(tracked[:, 0], tracked[:, 1], color=TRACKED_COLOR, linewidth=1.3, label="tracked")
    left.set_aspect("equal", adjustable="datalim")
    left.set_xlabel("world x (m)")
    left.set_ylabel("world y (m)")
    left.legend(fontsize=8)
    rows = np.arange(len(frames))
    sigma = np.array([np.nan if frame.sigma_m is None else 100 * frame.sigma_m for frame in frames])
    error = np.array([100 * frame.error_m if np.isfinite(frame.error_m) else np.nan for frame in frames])
    right.fill_between(rows, 0, sigma, color=SIGMA_COLOR, linewidth=0, label="one sigma, as answered")
    right.plot(rows, error, color=TRACKED_COLOR, linewidth=1.3, label="error")
    lost = rows[[frame.position is None for frame in frames]]
    if len(lost):
        right.plot(lost, np.zeros(len(lost)), "|", color=LOST_COLOR, label="not located")
    right.set_xlabel("frame")
    right.set_ylabel("position (cm)")
    right.set_ylim(bottom=0)
    right.legend(fontsize=8)
    figure.suptitle(title)
    figure.savefig(path, dpi=110)
