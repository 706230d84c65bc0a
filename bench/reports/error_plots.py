"""Plots of errors: cumulative curves, the way seen from above, errors against inliers, time by stage."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.ticker import FuncFormatter, LogFormatter

from bench.evaluation.pose_errors import GROSS_M, QueryOutcome
from bench.evaluation.run import Evaluation
from bench.reports.plot_style import GREY, PALETTE, label_axes, line_style, new_figure, save

SMALLEST_CM = 0.1
SMALLEST_DEG = 0.02


def curve_labels(evaluations: Sequence[Evaluation]) -> list[str]:
    """Return a label for each evaluation: of one configuration the variations' names say enough."""
    if len(evaluations) > 1 and len({evaluation.configuration for evaluation in evaluations}) == 1:
        return [evaluation.variation for evaluation in evaluations]
    return [evaluation.label for evaluation in evaluations]


def _columns(labels: Sequence[str]) -> int:
    longest = max(map(len, labels))
    return 6 if longest < 20 else 3 if longest < 45 else 1


def plot_cumulative(evaluations: Sequence[Evaluation], path: Path) -> Path:
    """Draw the share of all queries below each position and attitude error; what wasn't located never is below."""
    figure, labels = new_figure(11, 4.6), curve_labels(evaluations)
    left, right = figure.subplots(1, 2)
    for axes, name, unit, smallest, widest in (
        (left, "position_m", "position error (cm)", SMALLEST_CM, 100.0),
        (right, "orientation_deg", "attitude error (degrees)", SMALLEST_DEG, 10.0),
    ):
        factor = 100.0 if name == "position_m" else 1.0
        values = [np.sort([factor * getattr(o, name) for o in e.outcomes if o.located]) for e in evaluations]
        largest = max([widest, *(1.1 * float(errors[-1]) for errors in values if len(errors))])
        for number, (evaluation, errors) in enumerate(zip(evaluations, values, strict=True)):
            color, dashes = line_style(number)
            share = 100 * np.arange(len(errors) + 1) / len(evaluation.outcomes)
            x = np.concatenate([[smallest], np.maximum(errors, smallest), [largest]])
            y = np.append(share, share[-1])
            axes.step(
                x, y, where="post", color=color, linestyle=dashes, linewidth=1.6, label=evaluation.label
            )
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.set_xlim(smallest, largest)
        axes.set_ylim(0, 102)
        label_axes(axes, unit, "share of queries (%)")
    handles, _ = left.get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=_columns(labels), fontsize=8, frameon=False
    )
    return save(figure, path)


def plot_from_above(evaluation: Evaluation, path: Path) -> Path:
    """Draw keyframes, true and estimated camera centres on world x and y, each error as a segment."""
    figure = new_figure(6.4, 5.6)
    axes = figure.subplots()
    keyframes = np.array(evaluation.map.keyframe_centres).reshape(-1, 3)
    known = [o for o in evaluation.outcomes if o.truth_m is not None]
    truth = np.array([o.truth_m for o in known]).reshape(-1, 3)
    located = [(o.truth_m, o.estimate_m) for o in known if o.truth_m and o.estimate_m]
    missed = np.array([o.truth_m for o in known if not o.located]).reshape(-1, 3)
    # Many keyframes are a trail, few are marks.
    size = float(np.clip(2200 / max(len(keyframes), 1), 2, 22))
    axes.scatter(
        keyframes[:, 0], keyframes[:, 1], s=size, marker="s", color=GREY, linewidths=0, label="keyframe"
    )
    axes.scatter(truth[:, 0], truth[:, 1], s=26, facecolors="none", edgecolors=PALETTE[0], label="truth")
    if located:
        pairs = np.array(located)
        axes.add_collection(LineCollection(list(pairs[:, :, :2]), colors=PALETTE[1], linewidths=1.0))
        axes.scatter(pairs[:, 1, 0], pairs[:, 1, 1], s=9, color=PALETTE[1], linewidths=0, label="estimate")
    if len(missed):
        axes.scatter(
            missed[:, 0], missed[:, 1], s=42, marker="x", color="#000000", linewidths=1.2, label="not located"
        )
    axes.set_aspect("equal", adjustable="datalim")
    label_axes(axes, "world x (m)", "world y (m)", evaluation.label)
    figure.legend(loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return save(figure, path)


def plot_error_over_inliers(evaluations: Sequence[Evaluation], path: Path) -> Path:
    """Draw the position error of each located query over its inliers, and the limit of a wrong one."""
    figure, labels = new_figure(8.6, 4.8), curve_labels(evaluations)
    axes = figure.subplots()
    for number, evaluation in enumerate(evaluations):
        located = [o for o in evaluation.outcomes if o.located]
        marker = "o^s"[number // len(PALETTE) % 3]
        axes.scatter(
            [o.inliers for o in located], [max(100 * o.position_m, SMALLEST_CM) for o in located],
            s=14, marker=marker, color=line_style(number)[0], alpha=0.65, linewidths=0, label=labels[number],
        )  # fmt: skip
    axes.axhline(100 * GROSS_M, color="#000000", linewidth=0.8, linestyle="--")
    axes.annotate("wrong: 50 cm", (1.0, 100 * GROSS_M), xycoords=("axes fraction", "data"), ha="right", va="bottom",
                  fontsize=8)  # fmt: skip
    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(LogFormatter(minor_thresholds=(2, 0.5)))
    label_axes(axes, "inliers", "position error (cm)")
    figure.legend(loc="outside lower center", ncols=_columns(labels), fontsize=8, frameon=False)
    return save(figure, path)


def plot_stages(evaluations: Sequence[Evaluation], path: Path) -> Path:
    """Draw the median time of each stage of a located query, one bar an evaluation."""
    figure = new_figure(8.6, 1.6 + 0.32 * len(evaluations))
    axes = figure.subplots()
    stages = list(dict.fromkeys(stage for evaluation in evaluations for stage in evaluation.stages_ms))
    rows = np.arange(len(evaluations))
    start = np.zeros(len(evaluations))
    for number, stage in enumerate(stages):
        width = np.array([evaluation.stages_ms.get(stage, 0.0) for evaluation in evaluations])
        axes.barh(rows, width, left=start, color=line_style(number)[0], height=0.7, label=stage)
        start += width
    axes.set_yticks(rows, curve_labels(evaluations), fontsize=8)
    axes.invert_yaxis()
    label_axes(axes, "median time (ms)", "")
    axes.grid(visible=False, axis="y")
    if stages:
        figure.legend(loc="outside lower center", ncols=len(stages), fontsize=8, frameon=False)
    return save(figure, path)


def has_positions(outcomes: Sequence[QueryOutcome]) -> bool:
    """Return whether the outcomes can be drawn from above."""
    return any(outcome.truth_m is not None for outcome in outcomes)
