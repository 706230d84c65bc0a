"""Answers that a client may keep: with an ETag, and 304 while they are the same."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from fastapi import Request, Response

# Kept by the client that asked alone, and asked about again each time.
CACHE_CONTROL = "private, no-cache"
NOT_MODIFIED: dict[int | str, dict[str, Any]] = {
    304: {"description": "As it was when the client got it: If-None-Match names its ETag"}
}


def unless_known(request: Request, digest: str, make: Callable[[], Response]) -> Response:
    """Return an answer whose content has a digest, made only if the client doesn't have it yet."""
    if is_known(request, digest):
        return Response(status_code=304, headers=_headers(digest))
    response = make()
    response.headers.update(_headers(digest))
    return response


def is_known(request: Request, digest: str) -> bool:
    """Whether the client says that it has the content with a digest."""
    known = [each.strip() for each in request.headers.get("if-none-match", "").split(",")]
    return "*" in known or any(each.removeprefix("W/") == f'"{digest}"' for each in known)


def _headers(digest: str) -> dict[str, str]:
    # Weak, since the same content may be sent compressed.
    return {"ETag": f'W/"{digest}"', "Cache-Control": CACHE_CONTROL}
