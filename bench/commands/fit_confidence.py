"""`roomfix fit-confidence`: the model behind `confidence`, from the outcomes of evaluations."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from app.commands.console import console
from bench.evaluation.confidence_fit import fit_confidence
from bench.evaluation.reliability import read_outcomes


def fit_confidence_command(
    files: Annotated[
        list[Path],
        typer.Argument(exists=True, dir_okay=False, help="evaluation.json of one or more evaluations."),
    ],
) -> None:
    """Fit the probability that a pose is within 0.5 m and 5 degrees to all poses that were judged."""
    outcomes = [
        outcome for path in files for group in read_outcomes(path, True).values() for outcome in group
    ]
    fit = fit_confidence(outcomes)
    console.print(f"{fit.poses} poses, {fit.right} of them right; log loss {fit.log_loss}")
    console.print(f"intercept {fit.model.intercept}")
    names = ("inlier ratio", "coverage", "-log10 sigma", "distinct share", "rival share")
    for name, weight in zip(names, fit.model.weights, strict=True):
        console.print(f"{name} {weight}")
