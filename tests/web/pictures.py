"""Pictures of pages: kept as the test's output, and those of the walk-through also in the folder `DOCS_PICTURES`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

QUALITY = 75
WALK_THROUGH = Path(__file__).parents[2] / "docs" / "walk-through.md"


def keep_picture(page: Any, folder: Path, name: str) -> None:
    """Write what the page shows into the test's folder as PNG, and as JPEG where the docs show it and want it anew."""
    page.screenshot(path=folder / f"{name}.png")
    docs = os.environ.get("DOCS_PICTURES")
    if docs and f"/{name}.jpg" in WALK_THROUGH.read_text(encoding="utf-8"):
        Path(docs).mkdir(parents=True, exist_ok=True)
        page.screenshot(path=Path(docs) / f"{name}.jpg", type="jpeg", quality=QUALITY)
