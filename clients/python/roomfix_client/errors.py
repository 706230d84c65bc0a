"""What goes wrong."""

from __future__ import annotations

import httpx


class RoomfixError(Exception):
    """The server refused a call: `status`, a stable `code`, and a sentence that says what to change."""

    def __init__(self, status: int, code: str, detail: str, retry_after_s: float | None = None) -> None:
        super().__init__(detail)
        self.status = status
        self.code = code
        self.retry_after_s = retry_after_s


class BuildError(Exception):
    """A build failed or was cancelled."""


def error_of(answer: httpx.Response) -> RoomfixError:
    """Return the error of an answer, also of one that a proxy in between wrote."""
    try:
        body = answer.json()
        code, detail = str(body["code"]), str(body["detail"])
    except (ValueError, KeyError, TypeError):
        code, detail = "http_error", f"The server answered with status {answer.status_code}."
    after = answer.headers.get("Retry-After", "")
    return RoomfixError(answer.status_code, code, detail, float(after) if after.isdigit() else None)
