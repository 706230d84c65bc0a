"""One table from domain errors to status codes; every error body is RFC 9457 problem+json."""

from __future__ import annotations

import errno
import logging
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.routing import Match

from app import errors
from app.api.deps import ID_IN_WORDS, ID_PATTERN
from app.api.requests.fields import NAME_IN_WORDS, NAME_PATTERN
from app.api.schemas import PROBLEM_MEDIA_TYPE
from app.limits import limit

log = logging.getLogger("roomfix.api")
# The version of the tus protocol that uploads speak.
TUS_VERSION = "1.0.0"
# Patterns of texts, as a sentence says them.
IN_WORDS = {ID_PATTERN: ID_IN_WORDS, NAME_PATTERN: NAME_IN_WORDS}
METHODS = ("DELETE", "GET", "HEAD", "PATCH", "POST", "PUT")

# The first class that fits decides, so that special ones stand above their base.
STATUS: tuple[tuple[type[errors.RoomfixError], int], ...] = (
    (errors.ImageTooLargeError, 413),
    (errors.UploadTooLargeError, 413),
    (errors.UnsupportedImageError, 415),
    (errors.UnsupportedMediaError, 415),
    (errors.InvalidInputError, 422),
    (errors.DegenerateGeometryError, 422),
    (errors.AuthenticationError, 401),
    (errors.PermissionDeniedError, 403),
    (errors.NotFoundError, 404),
    (errors.UploadLockedError, 423),
    (errors.ConflictError, 409),
    (errors.UnknownProtocolError, 412),
    (errors.RateLimitError, 429),
    (errors.BusyError, 503),
    (errors.MapDamagedError, 503),
    (errors.StorageFullError, 507),
    (errors.StorageError, 503),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorOptions:
    """What an error answer holds."""

    retry_after_s: int = limit(
        1,
        "When a client may try again, as `Retry-After` of a 503 says.",
        chosen="By hand: most queries take less, so that a place in the queue has become free.",
    )
    database_retry_after_s: int = limit(
        5,
        "The same where the database is locked by another process.",
        chosen="By hand: a backup takes longer than a query.",
    )
    damage_retry_after_s: int = limit(
        60,
        "The same where a map is damaged on the server, or its disk can't be used.",
        chosen="By hand: an operator has to act.",
    )
    max_reported_fields: int = limit(
        5,
        "Largest number of fields of a request that an answer says something about.",
        chosen="By hand: the sentence stays readable; what is mended shows the next.",
    )


OPTIONS = ErrorOptions()
# After how many seconds a client should try again, by the first class that fits.
RETRY_AFTER_S: tuple[tuple[type[errors.RoomfixError], int], ...] = (
    (errors.DatabaseBusyError, OPTIONS.database_retry_after_s),
    (errors.BusyError, OPTIONS.retry_after_s),
    (errors.MapDamagedError, OPTIONS.damage_retry_after_s),
    (errors.StorageError, OPTIONS.damage_retry_after_s),
)


def status_of(error: errors.RoomfixError) -> int:
    """Return the status code of a domain error."""
    return next((status for kind, status in STATUS if isinstance(error, kind)), 500)


def problem(
    status: int, code: str, detail: str, headers: dict[str, str] | None = None, **more: Any
) -> JSONResponse:
    """Return a problem+json answer."""
    body = {"type": "about:blank", "title": HTTPStatus(status).phrase, "status": status, "code": code}
    body["detail"] = detail
    return JSONResponse({**body, **more}, status_code=status, media_type=PROBLEM_MEDIA_TYPE, headers=headers)


def problem_of(error: errors.RoomfixError) -> JSONResponse:
    """Return the answer of a domain error."""
    status = status_of(error)
    if status == 500:
        log.error("unmapped error", exc_info=error)
    return problem(status, error.code, str(error), headers_of(error, status))


def allowed_methods(request: Request) -> list[str]:
    """Return the methods that some route at a request's path takes, and HEAD where it takes GET."""
    taken = [
        method
        for method in METHODS
        if any(
            route.matches({**request.scope, "method": method})[0] is Match.FULL
            for route in request.app.routes
        )
    ]
    return sorted({*taken, "HEAD"}) if "GET" in taken else taken


def install_error_handlers(app: FastAPI) -> None:
    """Make every expected error a problem+json answer; `RequestIdMiddleware` answers all others."""

    async def domain(_: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, errors.RoomfixError)  # noqa: S101 - registered for this class
        return problem_of(error)

    async def validation(_: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, RequestValidationError)  # noqa: S101 - registered for this class
        fields = [_field(entry) for entry in error.errors()[: OPTIONS.max_reported_fields]]
        detail = "; ".join(f"{field['field']}: {field['message']}" for field in fields)
        return problem(422, "invalid_request", detail or "The request is not valid.", fields=fields)

    async def http(request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, HTTPException)  # noqa: S101 - registered for this class
        codes = {404: "not_found", 405: "method_not_allowed", 400: "bad_request", 422: "invalid_request"}
        detail = "There is nothing at this address." if error.status_code == 404 else str(error.detail)
        headers = dict(error.headers) if error.headers else None
        if error.status_code == 405:
            allowed = allowed_methods(request)
            headers = {"Allow": ", ".join(allowed)}
            detail = f"This address takes {', '.join(allowed)}."
        return problem(error.status_code, codes.get(error.status_code, "http_error"), detail, headers)

    async def disk(_: Request, error: Exception) -> JSONResponse:
        number = getattr(error, "errno", None)
        if number in (errno.ENOSPC, errno.EDQUOT):
            return problem_of(
                errors.StorageFullError("No space is left on the server's disk; nothing was stored.")
            )
        if number in (errno.EROFS, errno.EACCES, errno.EIO):
            log.error("the disk can't be used", exc_info=error)
            return problem_of(
                errors.StorageError("The server's disk can't be used; an operator has to look at it.")
            )
        raise error

    app.add_exception_handler(errors.RoomfixError, domain)
    app.add_exception_handler(OSError, disk)
    app.add_exception_handler(RequestValidationError, validation)
    app.add_exception_handler(HTTPException, http)


def headers_of(error: errors.RoomfixError, status: int) -> dict[str, str] | None:
    """Return the headers that a status code asks for."""
    if status == 401:
        # RFC 6750, section 3: the scheme is followed by a parameter; some clients fail where it is not.
        return {"WWW-Authenticate": 'Bearer realm="roomfix"'}
    if status == 412:
        return {"Tus-Version": TUS_VERSION}
    if isinstance(error, errors.RateLimitError):
        return {"Retry-After": str(error.retry_after_s)}
    retry_s = next((seconds for kind, seconds in RETRY_AFTER_S if isinstance(error, kind)), None)
    return None if retry_s is None else {"Retry-After": str(retry_s)}


def _field(entry: Any) -> dict[str, str]:
    place = ".".join(str(part) for part in entry["loc"] if part != "body")
    message = str(entry["msg"])
    if entry["type"] == "string_pattern_mismatch":
        message = IN_WORDS.get(entry["ctx"]["pattern"], message)
    return {"field": place or "body", "message": message}
