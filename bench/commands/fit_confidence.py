"""`roomfix fit-confidence`: the model behind `confidence`, from the outcomes of evaluations."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from app.errors import InvalidInputError
from bench.evaluation.confidence_fit import (
    ConfidenceFit,
    fit_camera_confidence,
    fit_confidence,
    held_out,
)
from bench.evaluation.pose_errors import QueryOutcome
from bench.evaluation.reliability import read_outcomes, scene_of
from bench.figures.shown import FiguresTitle, Shown
from bench.reports.sections import reliability_table
from bench.reports.tables import plain_table


def fit_confidence_command(
    files: Annotated[
        list[Path],
        typer.Argument(exists=True, dir_okay=False, help="evaluation.json of one or more evaluations."),
    ],
    figures: FiguresTitle = None,
) -> None:
    """Fit the probability that a pose is within 0.5 m and 5 degrees: to all poses that were judged, and to the answers
    whose camera is not confirmed; and compare the second model with scenes that it was not fitted to."""
    groups: dict[str, list[QueryOutcome]] = {}
    for path in files:
        for name, group in read_outcomes(path, True).items():
            groups.setdefault(name, []).extend(group)
    outcomes = [outcome for group in groups.values() for outcome in group]
    shown = Shown()
    try:
        _show_poses(fit_confidence(outcomes), shown)
    except InvalidInputError as error:
        shown.line(f"Nothing is fitted to all poses. {error}")
    _show_cameras(groups, outcomes, shown)
    shown.write("fit-confidence", figures)


def _show_poses(fit: ConfidenceFit, shown: Shown) -> None:
    shown.line(f"{fit.poses} poses, {fit.right} of them right; log loss {fit.log_loss}")
    table = Table("term", "weight")
    table.add_row("intercept", str(fit.model.intercept))
    names = ("inlier ratio", "coverage", "-log10 sigma", "distinct share", "rival share")
    for name, weight in zip(names, fit.model.weights, strict=True):
        table.add_row(name, str(weight))
    shown.table(table)


def _show_cameras(
    groups: dict[str, list[QueryOutcome]], outcomes: Sequence[QueryOutcome], shown: Shown
) -> None:
    cameras = fit_camera_confidence(outcomes)
    shown.line(f"{cameras.answers} answers whose camera is not confirmed, {cameras.right} of them right.")
    table = Table("term", "weight")
    table.add_row("intercept", str(cameras.model.intercept))
    names = ("-log10 accuracy", "the matches may fit no camera")
    for name, weight in zip(names, cameras.model.weights, strict=True):
        table.add_row(name, str(weight))
    shown.table(table)
    if len({scene_of(name) for name in groups}) > 2:
        shown.line("Each scene with the second model fitted to the other scenes:")
        shown.table(plain_table(reliability_table(held_out(groups))))
