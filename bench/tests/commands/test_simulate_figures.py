"""`roomfix simulate-figures`: figures of logged walks, be the simulation over or not."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from app.cli import app
from app.errors import InvalidInputError
from bench.simulation.log import WalkLog
from bench.simulation.walks import Outcome

RUN = CliRunner()


def outcome(trip: int, end: str) -> Outcome:
    values = {each.name: 1 for each in fields(Outcome)}
    return Outcome(**{**values, "trip": trip, "length_m": 20.0, "destination": "0:desk", "end": end})  # type: ignore[arg-type]


def test_the_figures_of_several_logs_are_shown_together(tmp_path: Path) -> None:
    logs = [tmp_path / "a.jsonl", tmp_path / "b.jsonl"]
    for number, (path, end) in enumerate(zip(logs, ("arrived", "lost"), strict=True)):
        walk = {"relocation": "on", "fps": 4.0, "light": 1.0, "trip": number}
        WalkLog(path).add(walk, outcome(number, end))
    found = RUN.invoke(
        app,
        [
            "simulate-figures",
            *map(str, logs),
            "--json",
            str(tmp_path / "f.json"),
            "--report",
            str(tmp_path / "r"),
        ],
    )
    assert found.exit_code == 0, found.output
    assert "lost 1" in found.output
    figures = json.loads((tmp_path / "f.json").read_text())["figures"]
    assert [(row["length_m"], row["runs"], row["success_percent"]) for row in figures] == [
        (20.0, 2, 50.0),
        (None, 2, 50.0),
    ]
    assert (tmp_path / "r").is_dir()


def test_walks_are_told_by_the_kind_of_place_walked_to(tmp_path: Path) -> None:
    log, file = tmp_path / "a.jsonl", tmp_path / "f.json"
    ends = {"0:0-hall": "arrived", "1:1-hall": "lost", "0:door-0-room-3-0-room-4-0": "arrived"}
    for number, (destination, end) in enumerate(ends.items()):
        walk = {"relocation": "on", "fps": 4.0, "light": 1.0, "trip": number}
        WalkLog(log).add(walk, replace(outcome(number, end), destination=destination))
    found = RUN.invoke(app, ["simulate-figures", str(log), "--by-place", "--json", str(file)])
    assert found.exit_code == 0, found.output
    rows = {
        cells[2]: cells[3:5]
        for line in found.output.splitlines()
        if len(cells := [cell.strip() for cell in line.split("│")]) == 8
    }
    assert (rows["halls"], rows["offices"]) == (["2", "50"], ["1", "100"])


def test_a_log_that_is_not_there_is_said(tmp_path: Path) -> None:
    found = RUN.invoke(app, ["simulate-figures", str(tmp_path / "none.jsonl")])
    assert isinstance(found.exception, InvalidInputError)
    (tmp_path / "empty.jsonl").touch()
    with pytest.raises(InvalidInputError, match="No walk"):
        RUN.invoke(app, ["simulate-figures", str(tmp_path / "empty.jsonl")], catch_exceptions=False)
