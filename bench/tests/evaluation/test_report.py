"""The page of a report, and names for what it compares."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from app.engine.mapping.options import BuildOptions, parse_build_options
from app.errors import InvalidInputError
from bench.evaluation.naming import name_by_difference
from bench.reports.report import Report, ReportFigure, ReportTable, Section


class Page(HTMLParser):
    """What a browser would find in a page: cells by row, image sources, headings."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.images: list[str] = []
        self.tags: list[str] = []
        self.words = ""
        self._cell = False
        self.text = path.read_text(encoding="utf-8")
        self.feed(self.text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag == "img":
            self.images.append(dict(attrs)["src"] or "")
        if tag in ("td", "th"):
            self.rows[-1].append("")
        self._cell = tag in ("td", "th")

    def handle_endtag(self, tag: str) -> None:
        self._cell = False

    def handle_data(self, data: str) -> None:
        self.words += data
        if self._cell:
            self.rows[-1][-1] += data


def test_a_page_shows_sections_tables_and_figures(tmp_path: Path) -> None:
    report = Report("Of <two> & more", tmp_path / "out")
    figure = report.directory / "a plot.png"
    figure.write_bytes(b"png")
    table = ReportTable(["what", "cm"], [["a < b", "1.5"]], "Caption")
    report.add(Section("First", "One.\n\nTwo.", [table], [ReportFigure(figure, 'a "plot"')]))
    report.add(Section("Second"))
    page = Page(report.write())
    assert page.rows == [["what", "cm"], ["a < b", "1.5"]]
    assert page.images == ["a%20plot.png"]
    assert "Of <two> & more" in page.words
    assert page.tags.count("h2") == 2
    assert page.tags.count("p") == 2


def test_a_page_needs_nothing_from_elsewhere(tmp_path: Path) -> None:
    report = Report("Alone", tmp_path)
    report.add(Section("S", "text"))
    text = report.write().read_text()
    assert not re.search(r"https?:|//|<script|<link|@import|url\(", text.replace("<!doctype html>", ""))


def test_text_is_never_markup(tmp_path: Path) -> None:
    report = Report("<script>", tmp_path)
    report.add(Section("<script>", "<script>", [ReportTable(["<script>"], [["<script>"]], "<script>")]))
    assert "script" not in Page(report.write()).tags


def test_a_figure_elsewhere_and_a_ragged_table_are_refused(tmp_path: Path) -> None:
    report = Report("R", tmp_path / "out")
    report.add(Section("S", figures=[ReportFigure(tmp_path / "other.png", "")]))
    with pytest.raises(ValueError, match="subpath"):
        report.write()
    with pytest.raises(ValueError, match="cell for each column"):
        ReportTable(["a", "b"], [["1"]])


def test_a_folder_that_is_a_file_is_refused_in_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InvalidInputError, match="can't be made"):
        Report("R", tmp_path / "file")


def test_json_has_no_infinity(tmp_path: Path) -> None:
    report = Report("R", tmp_path)
    with pytest.raises(ValueError, match="JSON"):
        report.write_json("a.json", {"x": float("inf")})
    assert json.loads(report.write_json("b.json", {"x": 1}).read_text()) == {"x": 1}


def test_options_are_named_by_what_sets_them_apart() -> None:
    paper = {"depth_scale": 1000}
    calibrated = {"depth_scale": 1000, "keyframes": {"thresholds": "calibrated"}}
    every = {"depth_scale": 1000, "keyframes": {"rule": "interval", "every": 5}}
    assert name_by_difference([paper, calibrated, every]) == [
        "defaults",
        "keyframes.thresholds=calibrated",
        "keyframes.rule=interval, keyframes.every=5",
    ]
    assert name_by_difference([calibrated]) == [""]
    assert isinstance(parse_build_options(every), BuildOptions)
