"""Pictures of pages: kept as the test's output, and where `DOCS_PICTURES` names a folder also there, for the docs."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

QUALITY = 75


def keep_picture(page: Any, folder: Path, name: str) -> None:
    """Write what the page shows into the test's folder as PNG, and as JPEG for the docs where that is wanted."""
    page.screenshot(path=folder / f"{name}.png")
    docs = os.environ.get("DOCS_PICTURES")
    if docs:
        Path(docs).mkdir(parents=True, exist_ok=True)
        page.screenshot(path=Path(docs) / f"{name}.jpg", type="jpeg", quality=QUALITY)
