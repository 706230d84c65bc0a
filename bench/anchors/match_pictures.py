"""Pictures of the matches of each feature method between two views (C figures 6.1 to 6.3)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from app.vision.features import LocalFeatureExtractor
from bench.anchors.features import MethodMatches, PosedPictures, matches_of

RIGHT_COLOR = "#2ca02c"
WRONG_COLOR = "#d62728"
LINE_WIDTH = 0.4


def draw_matches(methods: Sequence[LocalFeatureExtractor], pair: PosedPictures, path: Path) -> None:
    """Write one panel for each method: both pictures, right matches green, wrong ones red."""
    figure = Figure(figsize=(9, 3.6 * len(methods)), layout="constrained")
    for axes, method in zip(np.atleast_1d(figure.subplots(len(methods), 1)), methods, strict=True):
        _panel(axes, method.name, pair, matches_of(method, pair))
    figure.savefig(path, dpi=110)


def _panel(axes: Axes, name: str, pair: PosedPictures, matches: MethodMatches) -> None:
    height = max(pair.first.shape[0], pair.second.shape[0])
    beside = np.zeros((height, pair.first.shape[1] + pair.second.shape[1]), np.uint8)
    beside[: pair.first.shape[0], : pair.first.shape[1]] = pair.first
    beside[: pair.second.shape[0], pair.first.shape[1] :] = pair.second
    axes.imshow(beside, cmap="gray", vmin=0, vmax=255)
    moved = matches.second_px + np.array([pair.first.shape[1], 0])
    lines = np.stack([matches.first_px, moved], axis=1)
    for is_right, color in ((False, WRONG_COLOR), (True, RIGHT_COLOR)):
        chosen = lines[matches.right == is_right]
        axes.add_collection(LineCollection(list(chosen), colors=color, linewidths=LINE_WIDTH))
    right = int(matches.right.sum())
    axes.set_title(f"{name}: {right} of {len(matches.right)} matches are right", fontsize=10)
    axes.set_axis_off()
