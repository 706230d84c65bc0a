"""The RGB-D paper's tables 2 to 5 for evaluations by its protocol."""

from __future__ import annotations

from collections.abc import Sequence

from bench.evaluation.run import Evaluation
from bench.reports.report import ReportTable


def paper_tables(evaluations: Sequence[Evaluation]) -> list[ReportTable]:
    """Return the paper's tables in its units, a row each evaluation: images, their split, mean and median errors, and
    the errors that 90 % of the queries do not exceed.

    Means are of the located queries; medians and 90 % figures count a query that was not located as infinitely far
    off, which a dash stands for.
    """
    return [
        _table(
            "A tables 2 and 3: images of each sequence",
            ("test images", "without a depth image", "database images", "query images"),
            [
                (
                    (each.map.frames or each.map.keyframes) + len(each.outcomes),
                    (each.map.discarded or {}).get("no_depth", 0),
                    each.map.keyframes,
                    len(each.outcomes),
                )
                for each in evaluations
            ],
            evaluations,
        ),
        _table(
            "A table 4: mean and median errors",
            ("located %", "mean m, deg", "median m, deg"),
            [
                (
                    each.summary.located_percent,
                    _pose(each.summary.mean_cm, each.summary.mean_deg),
                    _pose(each.summary.median_cm, each.summary.median_deg),
                )
                for each in evaluations
            ],
            evaluations,
        ),
        _table(
            "A table 5 and figures 10 and 11: 90 % of the queries, and shares of them",
            ("90 % m, deg", "below 0.1 m %", "below 0.5 m %", "below 1 m %", "below 5 deg %"),
            [
                (
                    _pose(each.summary.p90_cm, each.summary.p90_deg),
                    *(_below(each, limit_m) for limit_m in (0.1, 0.5, 1.0)),
                    _below_deg(each, 5.0),
                )
                for each in evaluations
            ],
            evaluations,
        ),
    ]


def _table(
    caption: str, columns: Sequence[str], cells: Sequence[Sequence[object]], evaluations: Sequence[Evaluation]
) -> ReportTable:
    rows = [[each.label, *(str(cell) for cell in own)] for each, own in zip(evaluations, cells, strict=True)]
    return ReportTable(["sequence and pipeline", *columns], rows, caption)


def _pose(centimetres: float | None, degrees: float | None) -> str:
    position = "-" if centimetres is None else f"{centimetres / 100:.4f}"
    return f"{position}, {'-' if degrees is None else f'{degrees:.2f}'}"


def _below(evaluation: Evaluation, limit_m: float) -> str:
    return _share([each.located and each.position_m < limit_m for each in evaluation.outcomes])


def _below_deg(evaluation: Evaluation, limit_deg: float) -> str:
    return _share([each.located and each.orientation_deg < limit_deg for each in evaluation.outcomes])


def _share(hits: Sequence[bool]) -> str:
    return f"{100 * sum(hits) / len(hits):.1f}"
