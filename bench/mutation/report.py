"""What a run found as a section of docs/figures/mutants.md: how many mutants were killed, why others were not."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path

from bench.figures.page import FOLDER, Block, write_figures
from bench.figures.provenance import provenance
from bench.mutation.mutants import Mutant
from bench.mutation.run import Tried
from bench.reports.report import ReportTable

PAGE = "mutants"
REASONS = Path(__file__).parent / "equivalent.toml"
OPEN = "open: no test fails"

# Function, code before, code after.
Key = tuple[str, str, str]


def key_of(mutant: Mutant) -> Key:
    """Return what a mutant is known by, wherever in the module it is."""
    return mutant.function, mutant.before, mutant.after


def read_reasons(path: str, file: Path = REASONS) -> dict[Key, str]:
    """Return why mutants of a module behave as the module does."""
    entries = tomllib.loads(file.read_text(encoding="utf-8")).get("mutant", [])
    return {
        (each["function"], each["before"], each["after"]): each["reason"]
        for each in entries
        if each["module"] == path
    }


def summary_of(tried: Sequence[Tried], reasons: dict[Key, str]) -> str:
    """Return one sentence about a module's mutants; those that don't end are killed, too."""
    left = [each.mutant for each in tried if each.outcome == "survived"]
    known = sum(key_of(mutant) in reasons for mutant in left)
    return (
        f"{len(tried)} mutants: {len(tried) - len(left)} killed, {known} behave as the module does, "
        f"{len(left) - known} open."
    )


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


def write_section(path: str, tried: Sequence[Tried], reasons: dict[Key, str], folder: Path = FOLDER) -> Path:
    """Write the section of a module and return the page's path."""
    table = survivors_table(tried, reasons)
    blocks: list[Block] = [summary_of(tried, reasons)]
    if table.rows:
        blocks.append(table)
    return write_figures(PAGE, path, provenance(f"python -m bench.mutation {path}"), blocks, folder)
