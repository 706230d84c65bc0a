"""The picture of a calibration: pairs, fitted curves, thresholds, and the paper's curves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from app.engine.mapping.calibration_curves import Calibration, FittedCurve
from app.errors import InvalidInputError
from app.vision.keyframes import (
    ATTITUDE_CURVE,
    POSITION_CURVE,
    PowerLaw,
    matches_by_attitude_difference,
    matches_by_position_difference,
)

FIT_COLOR = "#4c78a8"
VALIDATION_COLOR = "#f58518"
CURVE_COLOR = "#111111"
PAPER_COLOR = "#8a8a8a"


def calibration_from_dict(figures: dict[str, Any]) -> Calibration:
    """Return the calibration whose `as_dict`, points included, is given; raises `InvalidInputError` without points."""
    try:
        position, attitude = (_curve_from_dict(figures[name]) for name in ("position", "attitude"))
        return Calibration(
            wanted_matches=figures["wanted_matches"],
            features=figures["features"],
            frames=figures["frames"],
            position=position,
            attitude=attitude,
            warnings=tuple(figures["warnings"]),
        )
    except (KeyError, TypeError) as error:
        raise InvalidInputError(
            f"These are not the figures of a calibration: {error!r} is missing."
        ) from None


def _curve_from_dict(figures: dict[str, Any]) -> FittedCurve:
    points = figures["points"]
    return FittedCurve(
        curve=PowerLaw(figures["a"], figures["b"]),
        threshold=figures["threshold"],
        reached=figures["reached"],
        range=(figures["range"][0], figures["range"][1]),
        other_limit=figures["other_limit"],
        rmse_fit=figures["rmse_fit"],
        rmse_validation=figures["rmse_validation"],
        left_at_threshold=figures["left_at_threshold"],
        differences=np.array([point["difference"] for point in points]),
        matches=np.array([point["matches"] for point in points]),
        held_back=np.array([point["held_back"] for point in points]),
        pairs_fit=figures["pairs_fit"],
        pairs_validation=figures["pairs_validation"],
    )


def draw_calibration(calibration: Calibration, title: str, path: Path) -> None:
    """Write the plot of both curves; the suffix of the path says as what (PNG, SVG, PDF)."""
    figure = Figure(figsize=(11, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    wanted = calibration.wanted_matches
    by_position = _PaperCurve(POSITION_CURVE, matches_by_position_difference)
    by_attitude = _PaperCurve(ATTITUDE_CURVE, matches_by_attitude_difference)
    _panel(left, calibration.position, by_position, wanted, "position difference", "m")
    _panel(right, calibration.attitude, by_attitude, wanted, "attitude difference", "rad")
    figure.suptitle(f"{title}: verified {calibration.features} matches of {calibration.frames} frames")
    figure.savefig(path, dpi=110)


@dataclass(frozen=True, slots=True)
class _PaperCurve:
    """The paper's own curve, and the matches that it expects at differences (A eq. 1-2)."""

    law: PowerLaw
    expected: Callable[[NDArray[np.float64]], NDArray[np.float64]]


def _panel(axes: Axes, fit: FittedCurve, paper: _PaperCurve, wanted: float, name: str, unit: str) -> None:
    x, y, held = fit.differences, fit.matches, fit.held_back
    axes.scatter(x[~held], y[~held], s=7, color=FIT_COLOR, alpha=0.5, linewidths=0, label="pairs of the fit")
    axes.scatter(x[held], y[held], s=9, color=VALIDATION_COLOR, alpha=0.7, linewidths=0, label="held back")
    inside = np.geomspace(*fit.range, 100)
    label = f"{fit.curve.a:.3g} x^{fit.curve.b:.3g}"
    axes.plot(inside, fit.curve(inside), color=CURVE_COLOR, linewidth=2, label=label)
    everywhere = np.geomspace(x.min(), x.max(), 200)
    label = f"paper: {paper.law.a:.4g} x^{paper.law.b:.4g}"
    axes.plot(everywhere, paper.expected(everywhere), "--", color=PAPER_COLOR, linewidth=1.5, label=label)
    axes.axhline(wanted, color=CURVE_COLOR, linewidth=0.6)
    axes.axvline(fit.threshold, color=CURVE_COLOR, linewidth=1, linestyle=":")
    axes.annotate(
        f" {fit.threshold:.3g} {unit}", (fit.threshold, 0.93), xycoords=("data", "axes fraction"), fontsize=9
    )
    axes.set_xscale("log")
    axes.set_ylim(0, 1.1 * max(float(np.quantile(y, 0.99)), 2 * wanted))
    axes.set_xlabel(f"{name} ({unit})")
    axes.set_ylabel("verified matches")
    axes.legend(fontsize=8, loc="upper right", framealpha=0.9, bbox_to_anchor=(1.0, 0.92))
