"""The tables of a comparison of real rooms."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table

from bench.rooms.compare import ONE_LOOK, OURS, RoomResult
from bench.rooms.rooms import KINDS, Room

COLUMNS = ("queries", "located", "right within 0.5 m", "within 5 cm", "wrong", "median, cm")
REFUSED = "right poses refused"


def splits_table(results: Sequence[RoomResult]) -> Table:
    """Return a row for every split, pipeline and variation; splits in their order, each pipeline beside the others."""
    table = Table("scene", "split: map / queries", "keyframes", "queries are", "pipeline", *COLUMNS, REFUSED)
    order = list(dict.fromkeys((each.room, each.split, each.variation) for each in results))
    for each in sorted(results, key=lambda r: order.index((r.room, r.split, r.variation))):
        table.add_row(
            each.room,
            each.split,
            str(each.keyframes),
            _variation(each.variation),
            each.pipeline,
            *_counts([each]),
            _text(each.median_cm),
            _refused([each]),
        )
    return table


def totals_table(results: Sequence[RoomResult]) -> Table:
    """Return a row for every kind of split, pipeline and variation, all scenes together."""
    table = Table("all scenes", "queries are", "pipeline", *COLUMNS[:-1], REFUSED)
    groups: dict[tuple[str, str, str], list[RoomResult]] = {}
    for each in results:
        groups.setdefault((each.kind, each.variation, each.pipeline), []).append(each)
    kinds = list(KINDS)
    for (kind, variation, pipeline), chosen in sorted(groups.items(), key=lambda it: kinds.index(it[0][0])):
        table.add_row(KINDS[kind], _variation(variation), pipeline, *_counts(chosen), _refused(chosen))
    return table


def rooms_table(rooms: Sequence[Room]) -> Table:
    """Return what was chosen on each scene: its rows do not report that."""
    table = Table("scene", "limits that were chosen on it")
    for room in rooms:
        table.add_row(room.folder, room.decided)
    return table


def _counts(results: Sequence[RoomResult]) -> list[str]:
    """Return what the columns but the last say of results together."""
    counts = (
        sum(len(each.outcomes) for each in results),
        sum(each.located for each in results),
        sum(each.right for each in results),
        sum(each.within_5cm for each in results),
        sum(each.wrong for each in results),
    )
    return [str(count) for count in counts]


def _refused(results: Sequence[RoomResult]) -> str:
    """Return how many refused queries had a right pose; the plain pipelines do not keep the poses they refuse."""
    if results[0].pipeline not in (OURS, ONE_LOOK):
        return ""
    return f"{sum(each.right_refused for each in results)} of {sum(each.refused for each in results)}"


def _variation(name: str) -> str:
    return "as they are" if name == "none" else name


def _text(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"
