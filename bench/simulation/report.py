"""The report of simulated navigation: tables, success and error by length of the path, compared with the thesis's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from bench.reports.plot_style import GREY, label_axes, line_style, new_figure, save
from bench.reports.report import Report, ReportFigure, ReportTable, Section
from bench.simulation.summary import (
    COLUMNS,
    THESIS_MEAN_M,
    THESIS_SUCCESS_PERCENT,
    Figures,
    Setting,
)
from bench.simulation.walks import Outcome

TEXT = (
    "A walker in the demonstration venue does only what guidance says. A trip succeeds when the walker comes within "
    "2 m of every turn, stair and landmark of the route, in order, and guidance says `arrived` within 3 m of the "
    "destination. Errors are of the place on the plan; of the 90 % errors of the trips the median is shown."
)
TRIP_COLUMNS = (
    "setting", "trip", "to", "route m", "end", "spots", "passed", "walked m", "seconds", "mean error m",
    "largest error m", "off the goal m",
)  # fmt: skip


def write_report(
    directory: Path, figures: Sequence[Figures], outcomes: Mapping[Setting, Sequence[Outcome]]
) -> Path:
    """Write the report into a folder and return its page; raises `InvalidInputError` for a folder that can't be."""
    report = Report("Simulated navigation", directory)
    thesis = ["thesis", *[""] * 4, f"{THESIS_SUCCESS_PERCENT:g}", "", f"{THESIS_MEAN_M:g}"]
    thesis += [""] * (len(COLUMNS) - len(thesis))
    table = ReportTable(COLUMNS, [*(row.row() for row in figures), thesis])
    plots = [
        ReportFigure(_plot_success(figures, directory / "success.png"), "Successful navigations by length"),
        ReportFigure(_plot_errors(outcomes, directory / "errors.png"), "Mean position error of the trips"),
    ]
    report.add(Section("Navigations", TEXT, [table], plots))
    report.add(Section("Trips", "", [ReportTable(TRIP_COLUMNS, _trips(outcomes))]))
    report.write_json(
        "simulation.json",
        {
            "figures": [row.as_dict() for row in figures],
            "trips": [{**asdict(s), **asdict(one)} for s, found in outcomes.items() for one in found],
        },
    )
    return report.write()


def _trips(outcomes: Mapping[Setting, Sequence[Outcome]]) -> list[list[str]]:
    return [
        [
            setting.label, str(one.trip), one.destination, f"{one.route_m:g}", one.end, str(one.spots),
            str(one.passed), f"{one.walked_m:g}", f"{one.seconds:g}", str(one.mean_error_m or "-"),
            str(one.largest_error_m or "-"), f"{one.off_destination_m:g}",
        ]
        for setting, found in outcomes.items()
        for one in found
    ]  # fmt: skip


def _plot_success(figures: Sequence[Figures], path: Path) -> Path:
    figure = new_figure(6.4, 4.0)
    axes = figure.add_subplot()
    settings = list(dict.fromkeys(row.setting for row in figures))
    for number, setting in enumerate(settings):
        rows = [row for row in figures if row.setting == setting and row.length_m is not None]
        colour, dashes = line_style(number)
        lengths = np.array([row.length_m for row in rows], dtype=np.float64) + 0.6 * number
        shares = np.array([row.success_percent for row in rows])
        reach = np.abs(np.array([row.interval_percent for row in rows]).T - shares)
        axes.errorbar(
            lengths, shares, reach, color=colour, linestyle=dashes, marker="o", capsize=3, label=setting.label
        )
    axes.axhline(THESIS_SUCCESS_PERCENT, color=GREY, linestyle="--", label="thesis, 90.6 %")
    axes.set_ylim(0, 103)
    axes.legend(fontsize=8)
    label_axes(axes, "length of the path, m", "successful navigations, %, with 95 % interval")
    return save(figure, path)


def _plot_errors(outcomes: Mapping[Setting, Sequence[Outcome]], path: Path) -> Path:
    figure = new_figure(6.4, 4.0)
    axes = figure.add_subplot()
    for number, (setting, found) in enumerate(outcomes.items()):
        errors = np.sort([one.mean_error_m for one in found if one.mean_error_m is not None])
        colour, dashes = line_style(number)
        shares = 100.0 * np.arange(1, len(errors) + 1) / max(len(found), 1)
        axes.plot(errors, shares, color=colour, linestyle=dashes, label=setting.label)
    axes.axvline(THESIS_MEAN_M, color=GREY, linestyle="--", label="thesis, 0.46 m")
    axes.set_xlim(0, None)
    axes.set_ylim(0, 103)
    axes.legend(fontsize=8)
    label_axes(axes, "mean position error of a trip, m", "share of the trips, %")
    return save(figure, path)
