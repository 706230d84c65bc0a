"""Plots of confidence: the reliability diagram and the coverage-risk curve."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from bench.evaluation.reliability import Reliability
from bench.reports.plot_style import GREY, label_axes, line_style, new_figure, save

# A diagram of a localizer that is nearly always sure would be one spot in a corner of the unit square.
WIDEST_ZOOM = 0.8


def plot_reliability(measured: Mapping[str, Reliability], path: Path) -> Path:
    """Draw the measured share of right poses over the mean confidence of each bin, and one standard error."""
    figure = new_figure(6.4, 5.6)
    axes = figure.subplots()
    x_low = y_low = WIDEST_ZOOM
    for number, (name, reliability) in enumerate(measured.items()):
        color, dashes = line_style(number)
        x = np.array([b.confidence for b in reliability.bins])
        y = np.array([b.right for b in reliability.bins])
        count = np.array([b.count for b in reliability.bins])
        ece = "-" if reliability.ece is None else f"{reliability.ece:.3f}"
        axes.errorbar(
            x, y, yerr=np.sqrt(y * (1 - y) / np.maximum(count, 1)), color=color, linestyle=dashes, marker="o",
            markersize=5, linewidth=1.3, elinewidth=0.8, label=f"{name} (ECE {ece})",
        )  # fmt: skip
        x_low, y_low = min([x_low, *x]), min([y_low, *y])
    axes.plot([0, 1], [0, 1], color=GREY, linewidth=1, linestyle="--")
    # A little beyond 1, for the marks there.
    axes.set_xlim(max(0.0, np.floor(10 * x_low - 0.5) / 10), 1.01)
    axes.set_ylim(max(0.0, np.floor(10 * y_low - 0.5) / 10), 1.01)
    label_axes(axes, "confidence", "measured share within 0.5 m and 5 degrees", "Reliability")
    figure.legend(loc="outside lower center", fontsize=8, frameon=False)
    return save(figure, path)


def plot_coverage_risk(measured: Mapping[str, Reliability], path: Path) -> Path:
    """Draw the share of wrong answers over the share of queries that is answered, surest first."""
    figure = new_figure(6.4, 5.6)
    axes = figure.subplots()
    highest = 2.0
    for number, (name, reliability) in enumerate(measured.items()):
        color, dashes = line_style(number)
        risk = 100 * np.array(reliability.risk)
        axes.plot(
            100 * np.array(reliability.coverage), risk, color=color, linestyle=dashes, linewidth=1.6,
            marker="o", markersize=3, markevery=[-1] if len(risk) else [], label=name, clip_on=False,
        )  # fmt: skip
        highest = max([highest, *(1.15 * risk)])
    axes.set_xlim(0, 100)
    axes.set_ylim(0, highest)
    label_axes(
        axes, "queries answered, surest first (%)", "wrong among the answered (%)", "Coverage and risk"
    )
    figure.legend(loc="outside lower center", fontsize=8, frameon=False)
    return save(figure, path)
