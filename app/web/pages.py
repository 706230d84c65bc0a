"""The start page: try a photo, see it on the plan."""

from __future__ import annotations

from pathlib import Path

from fastapi import APIRouter
from fastapi.responses import FileResponse

STATIC = Path(__file__).parent / "static"
router = APIRouter(include_in_schema=False)


@router.get("/")
def start_page() -> FileResponse:
    """Return the start page."""
    return FileResponse(STATIC / "index.html")
