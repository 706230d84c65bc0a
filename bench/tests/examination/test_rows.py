"""Rows of a measurement in parts: they are read back as they were, and summed up by what must hold."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from app.errors import InvalidInputError
from bench.examination.repaired_maps import Located
from bench.examination.rows import RIGHT, Record, Row, summary

FOUND = Located(tried=10, located=10, median_m=0.0041, median_deg=0.168)
RIGHT_ROW = Row(
    name=RIGHT,
    is_mistake=False,
    verdict="confirmed",
    named=True,
    codes=(),
    sentence="",
    seconds=4.0,
    repairs=None,
    located=FOUND,
    commit="`a`",
)
MISTAKE = replace(
    RIGHT_ROW,
    name="axes",
    is_mistake=True,
    verdict="refused",
    codes=("camera_axes",),
    repairs={"camera_axes": "rub"},
    located=replace(FOUND, same_as=RIGHT),
)
ASKED = {"data": "kitchen", "frames": "0:60"}


def test_rows_are_read_back_and_those_of_other_arguments_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "rows.json"
    record = Record.at(path, ASKED)
    for row in (RIGHT_ROW, MISTAKE):
        record.add(row)
    assert Record.at(path, ASKED).rows == {RIGHT: RIGHT_ROW, "axes": MISTAKE}
    before = path.read_bytes()
    with pytest.raises(InvalidInputError, match="other arguments"):
        Record.at(path, {**ASKED, "frames": "0:30"})
    assert path.read_bytes() == before
    path.write_text("[]")
    with pytest.raises(InvalidInputError, match="no rows of this command"):
        Record.at(path, ASKED)


def test_a_mistake_serves_unless_the_examination_or_the_self_check_refuses_it() -> None:
    doubtful = replace(MISTAKE, verdict="doubtful")
    assert doubtful.serves
    assert not MISTAKE.serves
    assert not replace(doubtful, located=Located(tried=10, located=0, refusal="It locates none.")).serves


def test_the_summary_names_the_worst_map() -> None:
    worse = replace(
        MISTAKE, name="late", named=False, located=replace(FOUND, located=8, median_m=0.02), commit="`b`"
    )
    warned = replace(RIGHT_ROW, name="thinned", located=replace(FOUND, warnings=("Few places.",)))
    mistakes, right, maps, commits = summary([RIGHT_ROW, warned, MISTAKE, worse], "`b`")
    assert mistakes == "Mistakes: 2. Of these 0 serve, and 1 are named by the right cause."
    assert right == "Right scans: 2. Of these 0 are refused and 1 warned of."
    assert "locates 10 of 10, 0.41 cm" in maps
    assert "by that of late: 8 of 10, 2.00 cm" in maps
    assert len(summary([RIGHT_ROW, MISTAKE], "`a`")) == 3
    assert commits == "The rows were measured at `a` and `b`."


def test_a_right_scan_of_which_nothing_can_be_said_is_not_counted_as_warned_of() -> None:
    sparse = replace(
        RIGHT_ROW, name="thinned", verdict="unknown", codes=("too_little_in_common",), named=True
    )
    right, unknown = summary([RIGHT_ROW, sparse], "`a`")
    assert right == "Right scans: 2. Of these 0 are refused and 0 warned of."
    assert unknown.startswith("Nothing can be said of thinned")
    (mistaken,) = summary([RIGHT_ROW, replace(sparse, named=False)], "`a`")
    assert mistaken == "Right scans: 2. Of these 0 are refused and 1 warned of."
