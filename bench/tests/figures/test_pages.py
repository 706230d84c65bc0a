"""Pages of figures: a section is written with where it comes from, and written anew under its title."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from rich.table import Table
from typer.testing import CliRunner

from app.cli import app
from app.errors import InvalidInputError
from bench.figures import shown
from bench.figures.page import write_figures
from bench.figures.provenance import Provenance, command_line, commit_of, machine
from bench.figures.shown import report_table
from bench.figures.slow_tests import NO_REASON, TimedTest, read_tests, slow_table, write_page
from bench.reports.report import ReportTable

SOURCE = Provenance("roomfix track data", "`abc1234`", "2026-01-02", "A processor, 2 CPUs")


def table(value: str) -> ReportTable:
    return ReportTable(["what", "a | b"], [["median cm", value]])


def test_a_section_has_its_header_and_its_blocks(tmp_path: Path) -> None:
    path = write_figures("track", "With the map", SOURCE, ["A sentence.", table("0.4")], tmp_path)
    assert path.read_text() == (
        "# Figures: `roomfix track`\n\n"
        "## With the map\n\n"
        "- command: `roomfix track data`\n"
        "- commit: `abc1234`\n"
        "- date: 2026-01-02\n"
        "- machine: A processor, 2 CPUs\n\n"
        "A sentence.\n\n"
        "| what | a \\| b |\n| --- | --- |\n| median cm | 0.4 |\n"
    )


def test_a_title_is_written_anew_and_all_else_stays(tmp_path: Path) -> None:
    path = tmp_path / "track.md"
    path.write_text("# Mine\n\nAn introduction.\n\n## First\n\nold\n\n## Second\n\nkept\n")
    write_figures("track", "First", SOURCE, [table("1")], tmp_path)
    write_figures("track", "Third", SOURCE, [table("3")], tmp_path)
    text = path.read_text()
    assert text.startswith("# Mine\n\nAn introduction.\n\n## First\n\n- command:")
    assert "old" not in text
    assert [line for line in text.splitlines() if line.startswith("## ")] == [
        "## First",
        "## Second",
        "## Third",
    ]
    assert "\n\n## Second\n\nkept\n\n## Third\n" in text


@pytest.mark.parametrize("title", ["", "  ", "two\nlines"])
def test_a_title_is_one_line(tmp_path: Path, title: str) -> None:
    with pytest.raises(InvalidInputError, match="title of the section"):
        write_figures("track", title, SOURCE, [], tmp_path)


def test_a_command_line_can_be_repeated_elsewhere() -> None:
    given = [
        "track",
        "/somebody/home/kitchen",
        "--figures",
        "One fix",
        "--json=/tmp/a.json",
        "--plot",
        "a.png",
    ]
    given += ["--options", '{"camera": [1, 2]}', "--data-dir", "../demo", "--database", "0:300"]
    assert command_line(given) == (
        "roomfix track kitchen --options '{\"camera\": [1, 2]}' --data-dir demo --database 0:300"
    )


def test_a_commit_is_named_and_changes_are_admitted(tmp_path: Path) -> None:
    def git(*arguments: str) -> None:
        identity = ["-c", "user.name=x", "-c", "user.email=x@example.org"]
        subprocess.run(["git", "-C", str(tmp_path), *identity, *arguments], check=True, capture_output=True)

    with pytest.raises(InvalidInputError, match="git checkout"):
        commit_of(tmp_path / "none")
    git("init")
    (tmp_path / "app").mkdir()
    code = tmp_path / "app" / "a.py"
    code.write_text("a = 1\n")
    git("add", ".")
    git("commit", "-m", "first")
    name = commit_of(tmp_path)
    assert name.strip("`").isalnum()
    (tmp_path / "notes.md").write_text("not what is measured\n")
    assert commit_of(tmp_path) == name
    code.write_text("a = 2\n")
    assert commit_of(tmp_path) == f"{name}, with changes that are not committed"


def test_a_machine_has_processor_and_cores() -> None:
    processor, _, cores = machine().rpartition(", ")
    assert processor
    assert int(cores.removesuffix(" CPUs")) >= 1


def test_a_printed_table_becomes_a_value() -> None:
    titled = Table("stage", "ms", title="Times")
    titled.add_row("match", "1.5")
    assert report_table(titled) == ReportTable(["stage", "ms"], [("match", "1.5")], "Times")
    bare = Table(show_header=False)
    bare.add_row("a", "b")
    assert report_table(bare) == ReportTable(["", ""], [("a", "b")])


def test_a_command_writes_its_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    outcome = (
        '{"name": "q", "located": true, "position_m": 0.01, "orientation_deg": 0.1, "reason": null,'
        ' "inliers": 40, "confidence": 0.9, "milliseconds": 50}'
    )
    file = tmp_path / "evaluation.json"
    file.write_text(f'[{{"map": {{"name": "room"}}, "variation": "none", "outcomes": [{outcome}]}}]')
    given = ["reliability", str(file), "--figures", "One room"]
    monkeypatch.setattr(sys, "argv", ["roomfix", *given])
    monkeypatch.setattr(shown, "FOLDER", tmp_path)
    result = CliRunner().invoke(app, given)
    assert result.exit_code == 0, result.output
    text = (tmp_path / "reliability.md").read_text()
    assert "## One room\n\n- command: `roomfix reliability evaluation.json`\n- commit: `" in text
    assert "| 1 | 1 | 0 | 0.1 | 1 | 0.0 |" in text


def test_slow_tests_are_read_sorted_and_explained(tmp_path: Path) -> None:
    junit = tmp_path / "tests.xml"
    junit.write_text(
        '<testsuites><testsuite><testcase classname="tests.api.test_locate" name="test_a[x]" time="4.25"/>'
        '<testcase classname="tests.test_layers" name="test_b" time="9"/>'
        '<testcase classname="tests.test_layers" name="test_c" time="3.0"/></testsuite></testsuites>'
    )
    tests = read_tests(junit)
    assert tests[0] == TimedTest("tests/api/test_locate.py::test_a[x]", 4.25)
    rows = slow_table(tests).rows
    assert [row[:2] for row in rows] == [
        ["`tests/test_layers.py::test_b`", "9.0"],
        ["`tests/api/test_locate.py::test_a[x]`", "4.2"],
    ]
    assert rows[0][2] == NO_REASON
    assert "server" in rows[1][2]
    page = write_page(junit, "All", tmp_path)
    assert "2 of 3 tests take more than 3 s each, 13 s of 16 s together." in page.read_text()


def test_what_is_no_junit_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.xml").write_text("no")
    with pytest.raises(InvalidInputError, match="JUnit"):
        read_tests(tmp_path / "a.xml")
