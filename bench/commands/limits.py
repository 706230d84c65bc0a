"""`roomfix limits`: docs/limits.md from the code."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from app.commands.console import console
from bench.figures.provenance import ROOT
from bench.reports.limits_page import limits_page

PAGE = ROOT / "docs" / "limits.md"


def limits(path: Annotated[Path, typer.Option(help="The page to write.")] = PAGE) -> None:
    """Write docs/limits.md: every tuned number with its default, its meaning and how it was chosen."""
    path.write_text(limits_page(), encoding="utf-8")
    console.print(f"Wrote {path}.", soft_wrap=True)
