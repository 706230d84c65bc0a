"""README's figures: each row of its section on accuracy leads to the measurement that holds its numbers."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
LINK = re.compile(r"\((docs/figures/[\w-]+\.md)#([\w-]+)\)")
NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?![\w])")
COMMAND = re.compile(r"^- command: `roomfix [\w-]+", re.MULTILINE)
RECORDINGS = "RedKitchen"
PAPERS = {
    "A": [*(f"table {n}" for n in range(1, 6)), *(f"figure {n}" for n in range(1, 12))],
    "B": [*(f"table {n}" for n in range(1, 8)), *(f"figure {n}" for n in range(1, 10))],
    "C": ["table 6.1", *(f"figure 6.{n}" for n in range(1, 15))],
}


def section(text: str, title: str) -> str:
    """Return what stands under a heading of the second level."""
    return text.split(f"\n## {title}", 1)[1].split("\n## ", 1)[0]


def rows(text: str) -> list[list[str]]:
    """Return the cells of all rows of tables, headings left out."""
    lines = [line for line in text.splitlines() if line.startswith("| ")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    heads = {i for i, row in enumerate(cells[1:]) if set("".join(row)) <= {"-", " "}}
    return [row for i, row in enumerate(cells) if i not in heads and not set("".join(row)) <= {"-", " "}]


def slug(title: str) -> str:
    return re.sub(r"[^\w\- ]", "", title.strip().lower()).replace(" ", "-")


def figures_section(page: str, anchor: str) -> str:
    """Return the section of a page of figures, empty where there is none."""
    parts = (ROOT / page).read_text(encoding="utf-8").split("\n## ")[1:]
    return next((part for part in parts if slug(part.split("\n", 1)[0]) == anchor), "")


def numbers(text: str) -> set[float]:
    return {float(number) for number in NUMBER.findall(text)}


ACCURACY = rows(section(README, "How accurate and how fast"))


def test_the_section_on_accuracy_has_rows() -> None:
    assert len(ACCURACY) > 15


@pytest.mark.parametrize("row", ACCURACY, ids=[row[0][:60] for row in ACCURACY])
def test_each_figure_has_its_command(row: list[str]) -> None:
    link = LINK.search(row[-1])
    assert link, f"the row {row[0]!r} names no section of docs/figures"
    found = figures_section(*link.groups())
    assert COMMAND.search(found), f"{link.group(0)} is no section with a command"
    said = numbers(" ".join(row[1:-1]))
    assert said <= numbers(found), f"{sorted(said - numbers(found))} are not in {link.group(0)}"


def expanded(text: str) -> str:
    """Return a cell's text with ranges such as `figures 4 to 7` and lists such as `tables 3 and 4` written out."""

    def write_out(match: re.Match[str]) -> str:
        kind, first, word, last = match.groups()
        prefix, start = first.rpartition(".")[0], int(first.rpartition(".")[2])
        end = int(last.rpartition(".")[2])
        wanted = range(start, end + 1) if word == "to" else (start, end)
        if prefix and last.rpartition(".")[0] != prefix:
            return match.group(0)
        return ", ".join(f"{kind} {prefix + '.' if prefix else ''}{n}" for n in wanted)

    return re.sub(r"(table|figure)s ([\d.]+\d|\d) (to|and) ([\d.]+\d|\d)", write_out, text)


@pytest.mark.parametrize("paper", PAPERS)
def test_every_table_and_figure_of_the_papers_has_a_row(paper: str) -> None:
    text = (ROOT / "docs" / "papers.md").read_text(encoding="utf-8")
    part = next(each for each in text.split("\n## ")[1:] if each.startswith(f"{paper}. "))
    named = expanded(" | ".join(row[0] for row in rows(part)))
    missing = [each for each in PAPERS[paper] if not re.search(rf"{re.escape(each)}(?![\d.]*\d)", named)]
    assert not missing


def test_rendered_and_recorded_figures_share_no_row() -> None:
    text = (ROOT / "docs" / "papers.md").read_text(encoding="utf-8")
    mixed = [row for row in rows(text) if len(row) == 6 and "rendered" in row[3] and RECORDINGS in row[3]]
    assert not mixed
    recorded = section(README, "How accurate and how fast").split("**In the rendered building.**")[0]
    assert not [row for row in rows(recorded) if "rendered" in " ".join(row)]
