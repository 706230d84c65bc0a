"""A report: one HTML page of sections with text, tables and figures, which needs nothing but the files beside it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from string import Template
from typing import Any
from urllib.parse import quote

from app.errors import InvalidInputError

PAGE = Template("""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>
body { font: 15px/1.5 system-ui, sans-serif; color: #1b1b1b; max-width: 1200px; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.2rem; margin-top: 2.5rem; border-bottom: 1px solid #ddd; }
nav a { margin-right: 1rem; } p { max-width: 75ch; }
.scroll { overflow-x: auto; } table { border-collapse: collapse; font-size: 13px; margin: 1rem 0; }
caption { text-align: left; font-weight: 600; padding: 0.3rem 0; }
th, td { padding: 0.25rem 0.7rem; border-bottom: 1px solid #e4e4e4; text-align: right; vertical-align: bottom; }
th:first-child, td:first-child { text-align: left; white-space: nowrap; } thead th { border-bottom: 2px solid #999; }
.figures { display: flex; flex-wrap: wrap; gap: 1rem; }
figure { margin: 0; width: calc(50% - 0.5rem); min-width: 20rem; }
figure.wide { width: 100%; }
figure img { max-width: 100%; height: auto; } figcaption { font-size: 13px; color: #555; }
</style>
</head>
<body>
<h1>$title</h1>
<nav>$links</nav>
$sections
</body>
</html>
""")


@dataclass(frozen=True, slots=True)
class ReportTable:
    """Column titles, rows of as many cells, and what the table is called."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""

    def __post_init__(self) -> None:
        if any(len(row) != len(self.columns) for row in self.rows):
            raise ValueError("Every row of a table needs a cell for each column.")


@dataclass(frozen=True, slots=True)
class ReportFigure:
    """An image file below the report's folder, and what it shows; a wide one has a row of its own."""

    path: Path
    caption: str
    wide: bool = False


@dataclass(frozen=True, slots=True)
class Section:
    """A titled part of a report; `text` is plain, its blank lines part paragraphs."""

    title: str
    text: str = ""
    tables: Sequence[ReportTable] = ()
    figures: Sequence[ReportFigure] = ()


@dataclass(slots=True)
class Report:
    """A page in the making: add sections, then write it. Figures are drawn into `directory` beforehand."""

    title: str
    directory: Path
    sections: list[Section] = field(default_factory=list)

    def __post_init__(self) -> None:
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InvalidInputError(
                f"The report's folder {self.directory} can't be made: {error.strerror}."
            ) from None

    def add(self, *sections: Section) -> None:
        """Append sections."""
        self.sections += sections

    def write(self) -> Path:
        """Write `index.html` and return its path; raises `ValueError` for a figure outside the folder."""
        links = "".join(f'<a href="#s{i}">{escape(s.title)}</a>' for i, s in enumerate(self.sections))
        body = "\n".join(self._section(i, section) for i, section in enumerate(self.sections))
        path = self.directory / "index.html"
        page = PAGE.substitute(title=escape(self.title), links=links, sections=body)
        path.write_text(page, encoding="utf-8")
        return path

    def write_json(self, name: str, value: Any) -> Path:
        """Write figures as JSON into the folder of the page."""
        path = self.directory / name
        path.write_text(json.dumps(value, indent=1, allow_nan=False), encoding="utf-8")
        return path

    def _section(self, number: int, section: Section) -> str:
        parts = [f'<section id="s{number}"><h2>{escape(section.title)}</h2>']
        parts += [f"<p>{escape(text)}</p>" for text in section.text.split("\n\n") if text]
        parts += [_table(table) for table in section.tables]
        if section.figures:
            images = "".join(self._figure(figure) for figure in section.figures)
            parts.append(f'<div class="figures">{images}</div>')
        return "\n".join([*parts, "</section>"])

    def _figure(self, figure: ReportFigure) -> str:
        source = quote(figure.path.resolve().relative_to(self.directory.resolve()).as_posix())
        caption = escape(figure.caption)
        wide = ' class="wide"' if figure.wide else ""
        return (
            f'<figure{wide}><img src="{source}" alt="{caption}"><figcaption>{caption}</figcaption></figure>'
        )


def _table(table: ReportTable) -> str:
    head = "".join(f"<th>{escape(column)}</th>" for column in table.columns)
    rows = "\n".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in table.rows
    )
    caption = f"<caption>{escape(table.caption)}</caption>" if table.caption else ""
    return f'<div class="scroll"><table>{caption}<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>'
