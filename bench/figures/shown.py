"""What a measuring command shows: printed at once, and kept for a page of figures."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.table import Table

from app.commands.console import console
from bench.figures.page import FOLDER, Block, write_figures
from bench.figures.provenance import command_line, provenance
from bench.reports.report import ReportTable

FiguresTitle = Annotated[
    str | None,
    typer.Option("--figures", help="Write the tables into docs/figures too, as the section of this title."),
]


class Shown:
    """Prints tables and sentences, and keeps them in their order."""

    def __init__(self) -> None:
        self._blocks: list[Block] = []

    def table(self, table: Table) -> None:
        """Print a table."""
        console.print(table)
        self._blocks.append(report_table(table))

    def line(self, text: str) -> None:
        """Print a sentence."""
        console.print(text, soft_wrap=True)
        self._blocks.append(text)

    def write(self, page: str, title: str | None) -> None:
        """Write all that was shown as a section of a page of figures; without a title nothing is written."""
        if title is not None:
            path = write_figures(page, title, provenance(command_line()), self._blocks, FOLDER)
            console.print(f"Wrote {path}.", soft_wrap=True)


def report_table(table: Table) -> ReportTable:
    """Return a console's table as a value."""
    columns = [str(column.header) if table.show_header else "" for column in table.columns]
    rows = list(zip(*([str(cell) for cell in column.cells] for column in table.columns), strict=True))
    return ReportTable(columns, rows, str(table.title or ""))
