"""The sections of an evaluation's report: maps, errors, curves, confidence, places that are not in the map."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from app.vision.keyframes import PoseThresholds
from bench.evaluation.pose_errors import QueryOutcome
from bench.evaluation.reliability import POOLED, SURE, Reliability, measure_reliability, scene_of, with_pool
from bench.evaluation.run import Evaluation, MapFigures
from bench.reports.error_plots import (
    has_positions,
    plot_cumulative,
    plot_error_over_inliers,
    plot_from_above,
    plot_stages,
)
from bench.reports.reliability_plots import plot_coverage_risk, plot_reliability
from bench.reports.report import ReportFigure, ReportTable, Section

MAP_COLUMNS: Mapping[str, Callable[[MapFigures], object]] = {
    "images": lambda each: each.frames,
    "discarded": lambda each: each.discarded or None,
    "keyframe thresholds": lambda each: thresholds_text(each.thresholds),
    "keyframes": lambda each: each.keyframes,
    "features per keyframe": lambda each: each.features_per_keyframe,
    "size (MB)": lambda each: each.megabytes,
    "build (s)": lambda each: each.build_s,
}
ERROR_COLUMNS = {
    "queries": "queries",
    "located %": "located_percent",
    "mean cm": "mean_cm",
    "median cm": "median_cm",
    "90 % cm": "p90_cm",
    "mean deg": "mean_deg",
    "median deg": "median_deg",
    "90 % deg": "p90_deg",
    "within 10 cm, 5 deg %": "within_10cm_5deg_percent",
    "within 25 cm %": "within_25cm_percent",
    "wrong by over 0.5 m %": "gross_percent",
    "wrong by over 1 m %": "over_1m_percent",
    "median ms": "median_ms",
}


def evaluation_sections(evaluations: Sequence[Evaluation], directory: Path) -> list[Section]:
    """Draw the figures of evaluations into a folder, and return the sections that show them."""
    sections = [
        map_section(evaluations),
        Section(
            "Errors",
            "Means are of the located queries. Medians, 90 % figures and shares are of all queries: one that was not "
            "located is infinitely far off, which a dash stands for.",
            [error_table(evaluations)],
            [
                ReportFigure(
                    plot_cumulative(evaluations, directory / "cumulative.png"), "Cumulative errors", wide=True
                ),
                ReportFigure(
                    plot_error_over_inliers(evaluations, directory / "inliers.png"),
                    "Error against inliers",
                    wide=True,
                ),
            ],
        ),
        _from_above(evaluations, directory),
        _times(evaluations, directory),
        reliability_section(outcomes_by_configuration(evaluations), directory),
    ]
    if any(evaluation.absent for evaluation in evaluations):
        sections.append(_absent(evaluations))
    return sections


def map_section(evaluations: Sequence[Evaluation]) -> Section:
    """Return the table of the maps, one row each."""
    maps = {evaluation.configuration: evaluation.map for evaluation in evaluations}
    rows = [
        [name, *(cell(value(figures)) for value in MAP_COLUMNS.values())] for name, figures in maps.items()
    ]
    return Section("Maps", tables=[ReportTable(["map", *MAP_COLUMNS], rows)])


def error_table(evaluations: Sequence[Evaluation]) -> ReportTable:
    """Return the errors, one row an evaluation."""
    rows = [
        [
            evaluation.label,
            *(cell(getattr(evaluation.summary, name)) for name in ERROR_COLUMNS.values()),
            cell(evaluation.summary.reasons or None),
        ]
        for evaluation in evaluations
    ]
    return ReportTable(["queries of", *ERROR_COLUMNS, "not located"], rows)


def reliability_section(outcomes: Mapping[str, Sequence[QueryOutcome]], directory: Path) -> Section:
    """Return the section on confidence: a curve for each named group of outcomes, and for all together."""
    measured = {name: measure_reliability(group) for name, group in with_pool(outcomes).items()}
    return Section(
        "Confidence",
        "Confidence is the probability that a located query is within 0.5 m and 5 degrees. The expected calibration "
        "error (ECE) is over 10 bins of equal count; queries that were not located are left out of it. Coverage is the "
        "share of all queries that is answered when only the surest are.",
        [reliability_table(measured)],
        [
            ReportFigure(plot_reliability(measured, directory / "reliability.png"), "Reliability diagram"),
            ReportFigure(
                plot_coverage_risk(measured, directory / "coverage_risk.png"), "Coverage-risk curve"
            ),
        ],
    )


def reliability_table(measured: Mapping[str, Reliability], fitted: Sequence[str] = ()) -> ReportTable:
    """Return ECE and the share of wrong answers among the sure ones; the rows of `fitted` scenes are marked, which the
    model of confidence was fitted to."""

    def name_of(name: str) -> str:
        if name == POOLED:
            return name
        return f"{name} (fitted to it)" if scene_of(name) in fitted else name

    rows = [
        [name_of(name), *map(cell, (r.queries, r.located, r.wrong, r.ece, r.sure, r.sure_wrong_percent))]
        for name, r in measured.items()
    ]
    sure = f"at confidence >= {SURE}"
    return ReportTable(
        ["configuration", "queries", "located", "wrong", "ECE", sure, "wrong of these %"], rows
    )


def outcomes_by_configuration(evaluations: Sequence[Evaluation]) -> dict[str, list[QueryOutcome]]:
    """Return the outcomes of all variations of a configuration together, false fixes of absent places with them."""
    groups: dict[str, list[QueryOutcome]] = {}
    for evaluation in evaluations:
        false_fixes = evaluation.absent.located if evaluation.absent else ()
        groups.setdefault(evaluation.configuration, []).extend([*evaluation.outcomes, *false_fixes])
    return groups


def thresholds_text(thresholds: PoseThresholds | None) -> str | None:
    """Return keyframe thresholds as a cell of a table."""
    return f"{thresholds.position_m:.4f} m, {thresholds.attitude_rad:.4f} rad" if thresholds else None


def cell(value: object) -> str:
    """Return a value as a table shows it: a dash for None, counts by name with commas."""
    if value is None:
        return "-"
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {count}" for name, count in value.items())
    return str(value)


def _from_above(evaluations: Sequence[Evaluation], directory: Path) -> Section:
    figures = [
        ReportFigure(plot_from_above(evaluation, directory / f"above_{number:02d}.png"), evaluation.label)
        for number, evaluation in enumerate(evaluations)
        if has_positions(evaluation.outcomes)
    ]
    return Section("Seen from above", "Each line leads from the truth to the estimate.", figures=figures)


def _times(evaluations: Sequence[Evaluation], directory: Path) -> Section:
    stages = list(dict.fromkeys(stage for evaluation in evaluations for stage in evaluation.stages_ms))
    rows = [[e.label, *(cell(e.stages_ms.get(stage)) for stage in stages)] for e in evaluations]
    figure = ReportFigure(
        plot_stages(evaluations, directory / "stages.png"), "Median time by stage", wide=True
    )
    text = "Medians in milliseconds over the located queries, one query at a time."
    return Section("Time by stage", text, [ReportTable(["queries of", *stages], rows)], [figure])


def _absent(evaluations: Sequence[Evaluation]) -> Section:
    rows = [
        [e.label, cell(len(e.absent.outcomes)), cell(len(e.absent.located)), cell(e.absent.most_inliers)]
        for e in evaluations
        if e.absent
    ]
    table = ReportTable(["map", "pictures", "located", "most inliers"], rows)
    return Section("Places that are not in the map", "None of these may be located.", [table])
