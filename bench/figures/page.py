"""A page of figures: a section for each measurement, with its command, commit, date and machine."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from app.errors import InvalidInputError
from bench.figures.provenance import ROOT, Provenance
from bench.reports.report import ReportTable

FOLDER = ROOT / "docs" / "figures"
SECTION = "## "
# Pages whose sections are not written by commands of `roomfix`.
NOT_COMMANDS = ("mutants",)

# A table, or a sentence.
Block = ReportTable | str


def write_figures(
    page: str, title: str, source: Provenance, blocks: Sequence[Block], folder: Path = FOLDER
) -> Path:
    """Write a section of a page in docs/figures, in place of the one with the same title, and return the path.

    Other sections and the text above the first one stay. Raises `InvalidInputError` for a title that is no title.
    """
    if not title.strip() or "\n" in title:
        raise InvalidInputError("--figures takes the title of the section: one line of text.")
    path = folder / f"{page}.md"
    head, sections = _read(path) if path.is_file() else (_head(page), {})
    body = "\n\n".join(["\n".join(source.lines()), *(_markdown(block) for block in blocks)])
    sections[title.strip()] = body
    text = "\n\n".join([head, *(f"{SECTION}{name}\n\n{text}" for name, text in sections.items())])
    folder.mkdir(parents=True, exist_ok=True)
    path.write_text(text + "\n", encoding="utf-8")
    return path


def _head(page: str) -> str:
    return f"# Figures: {page}" if page in NOT_COMMANDS else f"# Figures: `roomfix {page}`"


def _read(path: Path) -> tuple[str, dict[str, str]]:
    """Return the text above the first section of a page, and the sections by title."""
    head, *parts = f"\n{path.read_text(encoding='utf-8')}".split(f"\n{SECTION}")
    sections = {}
    for part in parts:
        title, _, body = part.partition("\n")
        sections[title.strip()] = body.strip()
    return head.strip(), sections


def _markdown(block: Block) -> str:
    if isinstance(block, str):
        return block
    lines = [block.columns, ["---"] * len(block.columns), *block.rows]
    table = "\n".join(f"| {' | '.join(_cell(cell) for cell in row)} |" for row in lines)
    return f"{block.caption}:\n\n{table}" if block.caption else table


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ").strip()
