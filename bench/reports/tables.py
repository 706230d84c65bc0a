"""The tables that the evaluation commands print."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table

from bench.evaluation.run import Evaluation
from bench.reports.report import ReportTable
from bench.reports.sections import cell, thresholds_text

MAP_ROWS = ("keyframes", "features_per_keyframe", "megabytes", "lens_k1", "build_s", "discarded")
ERROR_ROWS = {
    "queries": "queries",
    "located %": "located_percent",
    "median cm": "median_cm",
    "median deg": "median_deg",
    "90 % cm": "p90_cm",
    "90 % deg": "p90_deg",
    "mean cm": "mean_cm",
    "mean deg": "mean_deg",
    "within 5 cm, 5 deg %": "within_5cm_5deg_percent",
    "within 10 cm, 5 deg %": "within_10cm_5deg_percent",
    "within 25 cm %": "within_25cm_percent",
    "wrong by over 0.5 m %": "gross_percent",
    "wrong by over 1 m %": "over_1m_percent",
    "largest error cm": "max_cm",
    "not located": "reasons",
    "median ms": "median_ms",
}
# Columns of the table of degraded queries.
VARIATION_COLUMNS = {
    "located %": "located_percent",
    "median cm": "median_cm",
    "mean cm": "mean_cm",
    "< 10 cm, 5 deg %": "within_10cm_5deg_percent",
    "< 25 cm %": "within_25cm_percent",
    "> 0.5 m %": "gross_percent",
    "median ms": "median_ms",
}


def maps_table(evaluations: Sequence[Evaluation]) -> Table:
    """Return maps and errors, one column an evaluation."""
    table = Table("")
    for evaluation in evaluations:
        table.add_column(evaluation.label, overflow="fold")
    for name in MAP_ROWS:
        table.add_row(name.replace("_", " "), *(str(getattr(each.map, name)) for each in evaluations))
    table.add_row(
        "keyframe thresholds", *(cell(thresholds_text(each.map.thresholds)) for each in evaluations)
    )
    for title, name in ERROR_ROWS.items():
        table.add_row(title, *(str(getattr(each.summary, name)) for each in evaluations))
    if any(each.absent for each in evaluations):
        table.add_row("absent places located", *(_false_fixes(each) for each in evaluations))
        table.add_row(
            "  most inliers there",
            *(str(each.absent.most_inliers) if each.absent else "" for each in evaluations),
        )
    return table


def variations_table(evaluations: Sequence[Evaluation]) -> Table:
    """Return the errors of variations, one row each, on 80 columns."""
    several = len({each.configuration for each in evaluations}) > 1
    table = Table()
    table.add_column("variation", overflow="fold", no_wrap=not several)
    for title in VARIATION_COLUMNS:
        table.add_column(title, min_width=5)
    for each in evaluations:
        name = f"{each.configuration}, {each.variation}" if several else each.variation
        table.add_row(name, *(str(getattr(each.summary, column)) for column in VARIATION_COLUMNS.values()))
    return table


def absent_lines(evaluations: Sequence[Evaluation]) -> list[str]:
    """Return a sentence for each time that absent places were asked."""
    return [
        f"{each.label}: {_false_fixes(each)} absent places located, {each.absent.most_inliers} inliers at most."
        for each in evaluations
        if each.absent
    ]


def plain_table(table: ReportTable) -> Table:
    """Return a report's table for the console."""
    out = Table(*table.columns, title=table.caption or None)
    for row in table.rows:
        out.add_row(*row)
    return out


def _false_fixes(evaluation: Evaluation) -> str:
    absent = evaluation.absent
    return f"{len(absent.located)} of {len(absent.outcomes)}" if absent else ""
