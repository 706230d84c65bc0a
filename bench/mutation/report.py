"""What a run found as a section of docs/figures/mutants.md: how many mutants were killed, why others were not."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bench.figures.page import FOLDER, Block, write_figures
from bench.figures.provenance import provenance
from bench.mutation.run import Tried
from bench.mutation.survivors import Key, key_of, summary_of
from bench.reports.report import ReportTable

PAGE = "mutants"
OPEN = "open: no test fails"


def survivors_table(tried: Sequence[Tried], reasons: dict[Key, str]) -> ReportTable:
    """Return the mutants that no test noticed."""
    rows = [
        [
            f"`{each.mutant.function or 'module'}`",
            f"`{each.mutant.before}` becomes `{each.mutant.after}`",
            reasons.get(key_of(each.mutant), OPEN),
        ]
        for each in tried
        if each.outcome == "survived"
    ]
    return ReportTable(["function", "change", "why it survives"], rows)


def write_section(
    path: str, tried: Sequence[Tried], reasons: dict[Key, str], folder: Path = FOLDER, asked: str = ""
) -> Path:
    """Write the section of a module and return the page's path; `asked` are the options that chose its mutants."""
    table = survivors_table(tried, reasons)
    blocks: list[Block] = [summary_of(tried, reasons)]
    if table.rows:
        blocks.append(table)
    return write_figures(PAGE, path, provenance(f"python -m bench.mutation {path}{asked}"), blocks, folder)
