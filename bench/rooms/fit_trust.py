"""`roomfix fit-trust`: the model behind `confidence` and refusals, from evaluations in several rooms."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from app.engine.query.trust import TERMS
from app.errors import InvalidInputError
from bench.evaluation.pose_errors import QueryOutcome
from bench.figures.shown import FiguresTitle, Shown
from bench.rooms.trust_fit import Judged, LeftOut, fit_trust, leave_one_out


def fit_trust_command(
    files: Annotated[
        list[Path],
        typer.Argument(
            exists=True, dir_okay=False, help="--json files of evaluate-rooms, evaluate and evaluate-demo."
        ),
    ],
    max_risk: Annotated[
        float, typer.Option(min=0, max=1, help="The risk at which poses are counted.")
    ] = 0.05,
    figures: FiguresTitle = None,
) -> None:
    """Fit the probability that a pose is right, and say what it is worth in a room that it was not fitted to."""
    rooms = {name: Judged.of(outcomes) for name, outcomes in _rooms(files).items()}
    together = Judged.join(list(rooms.values()))
    model = fit_trust(together)
    shown = Shown()
    shown.line(
        f"{len(together.right)} poses in {len(rooms)} rooms, {int(together.right.sum())} of them right."
    )
    table = Table("term", "weight", "typical value")
    table.add_row("intercept", str(model.intercept), "")
    for name, weight, typical in zip(TERMS, model.weights, model.typical, strict=True):
        table.add_row(name, str(weight), str(typical))
    shown.table(table)
    shown.table(_left_out_table(leave_one_out(rooms, max_risk)))
    shown.write("fit-trust", figures)


def _left_out_table(rooms: list[LeftOut]) -> Table:
    table = Table(
        "room left out", "poses", "right", "calibration error", "right, answered", "wrong, answered"
    )
    for each in rooms:
        table.add_row(
            each.room,
            str(each.poses),
            str(each.right),
            str(each.calibration_error),
            str(each.answered_right),
            str(each.answered_wrong),
        )
    return table


def _rooms(files: list[Path]) -> dict[str, list[QueryOutcome]]:
    """Return the outcomes of each room; a file that names no rooms is one."""
    rooms: dict[str, list[QueryOutcome]] = {}
    for path in files:
        for item in _items(path):
            absent = item.get("absent", {}).get("outcomes", [])
            outcomes = [QueryOutcome.from_dict(each) for each in [*item["outcomes"], *absent]]
            rooms.setdefault(str(item.get("room", path.stem)), []).extend(outcomes)
    return rooms


def _items(path: Path) -> list[dict[str, Any]]:
    try:
        parsed = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InvalidInputError(f"{path} can't be read as JSON: {error}.") from None
    items = [item for item in parsed if isinstance(item, dict) and isinstance(item.get("outcomes"), list)]
    if not items:
        raise InvalidInputError(f"{path} holds no outcomes of queries.")
    return items
