"""`roomfix reliability`: whether confidence means what it says, over the outcomes of several evaluations."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from app.commands.console import console
from bench.evaluation.pose_errors import QueryOutcome
from bench.evaluation.reliability import measure_reliability, read_outcomes, with_pool
from bench.figures.shown import FiguresTitle, Shown
from bench.reports.report import Report
from bench.reports.sections import reliability_section, reliability_table
from bench.reports.tables import plain_table


def reliability(
    files: Annotated[
        list[Path],
        typer.Argument(exists=True, dir_okay=False, help="evaluation.json of one or more evaluations."),
    ],
    report: Annotated[
        Path | None, typer.Option("--report", help="Write a page with both plots into this folder.")
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write all figures to this file.")] = None,
    fitted: Annotated[
        list[str] | None,
        typer.Option(help="Mark a scene that the model was fitted to; repeat it for several."),
    ] = None,
    figures_title: FiguresTitle = None,
) -> None:
    """Compare confidence with the share within 0.5 m and 5 degrees, over the queries of several evaluations."""
    groups: dict[str, list[QueryOutcome]] = {}
    for path in files:
        for name, outcomes in read_outcomes(path).items():
            groups.setdefault(name, []).extend(outcomes)
    measured = {name: measure_reliability(outcomes) for name, outcomes in with_pool(groups).items()}
    shown = Shown()
    shown.table(plain_table(reliability_table(measured, fitted or [])))
    shown.write("reliability", figures_title)
    figures = {name: each.as_dict() for name, each in measured.items()}
    if json_file is not None:
        json_file.write_text(json.dumps(figures, indent=1, allow_nan=False))
    if report is not None:
        page = Report("Reliability of confidence", report)
        page.add(reliability_section(groups, report))
        page.write_json("reliability.json", figures)
        console.print(f"The report is {page.write()}.", soft_wrap=True)
