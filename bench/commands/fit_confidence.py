"""`roomfix fit-confidence`: the model behind `confidence`, from the outcomes of evaluations."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from bench.evaluation.confidence_fit import fit_confidence
from bench.evaluation.reliability import read_outcomes
from bench.figures.shown import FiguresTitle, Shown


def fit_confidence_command(
    files: Annotated[
        list[Path],
        typer.Argument(exists=True, dir_okay=False, help="evaluation.json of one or more evaluations."),
    ],
    figures: FiguresTitle = None,
) -> None:
    """Fit the probability that a pose is within 0.5 m and 5 degrees to all poses that were judged."""
    outcomes = [
        outcome for path in files for group in read_outcomes(path, True).values() for outcome in group
    ]
    fit = fit_confidence(outcomes)
    shown = Shown()
    shown.line(f"{fit.poses} poses, {fit.right} of them right; log loss {fit.log_loss}")
    table = Table("term", "weight")
    table.add_row("intercept", str(fit.model.intercept))
    names = ("inlier ratio", "coverage", "-log10 sigma", "distinct share", "rival share")
    for name, weight in zip(names, fit.model.weights, strict=True):
        table.add_row(name, str(weight))
    shown.table(table)
    shown.write("fit-confidence", figures)
