"""The page of an evaluation of anchors: its tables and plots as sections of a report."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bench.anchors.pairs import SUMMARY_HEAD, AnchorSummary
from bench.reports.report import Report, ReportFigure, ReportTable, Section

ABOUT = (
    "A monitoring camera and a phone both see a POI. Errors are those of the phone's place on the plan, over located "
    "phones; shares are of all pairs, but that of wrong answers, which is of the located ones."
)


def anchor_section(
    title: str, tables: Mapping[str, Mapping[str, AnchorSummary]], directory: Path, figures: Mapping[str, str]
) -> Section:
    """Return the section of an evaluation; `figures` are file names in the report's folder with their captions."""
    return Section(
        f"Anchors: {title}",
        ABOUT,
        [
            ReportTable((name, *SUMMARY_HEAD), [(row, *summary.cells()) for row, summary in rows.items()])
            for name, rows in tables.items()
        ],
        [ReportFigure(directory / name, caption, wide=True) for name, caption in figures.items()],
    )


def query_section(figures: Mapping[str, Any]) -> Section:
    """Return the section of the other measurements: which anchor comes first, times, maps, matches."""
    tables = [
        ReportTable(("figure", "value"), list(_rows("", values)), caption=name)
        for name, values in figures.items()
    ]
    return Section("Which anchor, how long, and in the map", "", tables)


def write_report(sections: list[Section], directory: Path) -> Path:
    """Write the page and return its path."""
    report = Report("Anchors", directory)
    report.add(*sections)
    return report.write()


def _rows(prefix: str, values: Mapping[str, Any]) -> list[tuple[str, str]]:
    found: list[tuple[str, str]] = []
    for name, value in values.items():
        if isinstance(value, Mapping):
            found += _rows(f"{prefix}{name} ", value)
        else:
            found.append((f"{prefix}{name}", str(value)))
    return found
