"""The figures of an experiment's rows: errors of the located phones as the thesis states them, and what was refused."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from rich.table import Table

from bench.anchors.pairs import GOOD_M, WRONG_M, AnchorOutcome

COLUMNS = (
    "",
    "pipeline",
    "pairs",
    "located %",
    "mean m",
    "variance m2",
    "median m",
    "90 % m",
    f"within {GOOD_M:g} m, % of all",
    f"wrong by {WRONG_M:g} m, % of located",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorFigures:
    """Mean, variance, median and 90th percentile of the errors of located phones, None where there are none; shares in
    percent, `good_percent` of all pairs, `wrong_percent` of the located ones."""

    pairs: int
    located_percent: float
    mean_m: float | None
    variance_m2: float | None
    median_m: float | None
    p90_m: float | None
    good_percent: float
    wrong_percent: float | None

    def cells(self) -> tuple[str, ...]:
        """Return the figures as a table's cells."""
        values = (
            self.located_percent,
            self.mean_m,
            self.variance_m2,
            self.median_m,
            self.p90_m,
            self.good_percent,
            self.wrong_percent,
        )
        return (str(self.pairs), *("-" if value is None else f"{value:g}" for value in values))


def error_figures(outcomes: Sequence[AnchorOutcome]) -> ErrorFigures:
    """Return the figures of one row's outcomes."""
    errors = np.array([outcome.error_m for outcome in outcomes])
    found = errors[[outcome.located for outcome in outcomes]]
    is_any = len(found) > 0
    return ErrorFigures(
        pairs=len(outcomes),
        located_percent=round(100.0 * len(found) / len(outcomes), 1),
        mean_m=round(float(found.mean()), 3) if is_any else None,
        variance_m2=round(float(found.var()), 4) if is_any else None,
        median_m=round(float(np.median(found)), 3) if is_any else None,
        p90_m=round(float(np.percentile(found, 90)), 3) if is_any else None,
        good_percent=round(100.0 * float((errors < GOOD_M).mean()), 1),
        wrong_percent=round(100.0 * float((found > WRONG_M).mean()), 1) if is_any else None,
    )


def experiment_table(title: str, rows: Mapping[tuple[str, str], ErrorFigures]) -> Table:
    """Return the table of an experiment; rows are named by setting and pipeline."""
    table = Table(*COLUMNS, title=title)
    for (setting, pipeline), figures in rows.items():
        table.add_row(setting, pipeline, *figures.cells())
    return table
