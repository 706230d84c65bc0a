"""The client's side of resumable uploads (tus 1.0.0)."""

from __future__ import annotations

import base64
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import httpx

from app.commands.backoff import Backoff
from app.errors import InvalidInputError, NotFoundError, RoomfixError
from app.limits import limit

TUS = {"Tus-Resumable": "1.0.0"}
PART_MEDIA_TYPE = "application/offset+octet-stream"
# Answers after which the same request may succeed: the part before is still being written, or the server is busy.
PASSING = {408, 409, 423, 429, 500, 502, 503, 504}


@dataclass(frozen=True, slots=True, kw_only=True)
class UploadClientOptions:
    """How a file is sent."""

    timeout_s: float = limit(
        60.0,
        "Time that the server has for an answer, or to take the next piece.",
        chosen="By hand: the end of a large upload is written to the disk before it is answered.",
    )
    piece_bytes: int = limit(
        262_144, "Bytes that are read from the file at a time.", chosen="By hand: memory stays small."
    )
    max_starts: int = limit(
        3,
        "Times that an upload is begun whose server has lost it.",
        chosen="By hand: each of two servers is replaced once in an update.",
    )
    max_failures: int = limit(
        30,
        "Failures one after the other, with nothing arrived between them, after which sending is given up.",
        chosen="By hand: with the longest pause that is half an hour without a connection.",
    )


OPTIONS = UploadClientOptions()


@dataclass(frozen=True, slots=True)
class Sent:
    """How an upload went: its address and how often the connection broke."""

    url: str
    breaks: int


def begin_upload(client: httpx.Client, length: int, venue: str) -> str:
    """Begin an upload and return its address; raises `RoomfixError` with the server's reason when it is refused."""
    metadata = f"venue {base64.b64encode(venue.encode()).decode()}"
    answer = client.post(
        "/uploads", headers={**TUS, "Upload-Length": str(length), "Upload-Metadata": metadata}
    )
    if answer.status_code != 201:
        raise RoomfixError(reason(answer))
    return str(answer.headers["Location"])


def upload_file(
    client: httpx.Client,
    path: Path,
    venue: str,
    resume: str | None,
    begun: Callable[[str], None],
    report: Callable[[int], None] = lambda _: None,
) -> Sent:
    """Send a whole file, or the rest of the upload `resume`; an upload that its server has lost is begun anew.

    `begun` gets the address of each upload. Raises as `send_file`.
    """
    starts = 1
    while True:
        url = resume or begin_upload(client, path.stat().st_size, venue)
        begun(url)
        try:
            return send_file(client, url, path, report)
        except NotFoundError:
            if resume is not None or starts == OPTIONS.max_starts:
                raise
        starts += 1


def send_file(
    client: httpx.Client,
    url: str,
    path: Path,
    report: Callable[[int], None] = lambda _: None,
    pause: Callable[[float], None] = time.sleep,
) -> Sent:
    """Send the rest of a file to an upload, going on after each break from what has arrived.

    `report` gets the number of bytes that have been sent. Raises `InvalidInputError` when the file is not the one that
    the upload began with, `NotFoundError` when the server has no such upload, or no more, `RoomfixError` when it
    refuses, or can't be reached for long.
    """
    length, breaks, failures, before, backoff = path.stat().st_size, 0, 0, -1, Backoff()
    while True:
        try:
            offset = _offset(client, url, length)
            if offset > before:
                failures, before = 0, offset
                backoff.reset()
            if offset == length:
                return Sent(url, breaks)
            answer = client.patch(
                url,
                headers={
                    **TUS,
                    "Upload-Offset": str(offset),
                    "Content-Type": PART_MEDIA_TYPE,
                    "Content-Length": str(length - offset),
                },
                content=_pieces(path, offset, report),
            )
            if answer.status_code in PASSING:
                problem = reason(answer)
            elif answer.is_success:
                continue
            elif answer.status_code == 404:
                raise NotFoundError(reason(answer))
            else:
                raise RoomfixError(reason(answer))
        except httpx.TransportError as error:
            problem = type(error).__name__
            breaks += 1
        failures += 1
        if failures > OPTIONS.max_failures:
            raise RoomfixError(f"The upload is given up after {failures} failures: {problem}.")
        pause(backoff.next_pause_s())


def _offset(client: httpx.Client, url: str, length: int) -> int:
    """Return how much of an upload the server has."""
    answer = client.head(url, headers=TUS)
    if answer.status_code in PASSING:
        raise httpx.ReadError(f"the server answered {answer.status_code}")
    if answer.status_code == 404:
        raise NotFoundError(f"There is no upload {url}; it may have expired.")
    if answer.status_code != 200:
        raise RoomfixError(f"The upload {url} can't be continued: the server answered {answer.status_code}.")
    if int(answer.headers["Upload-Length"]) != length:
        raise InvalidInputError(
            f"The upload is of a file of {answer.headers['Upload-Length']} bytes; this one has {length}."
        )
    return int(answer.headers["Upload-Offset"])


def _pieces(path: Path, offset: int, report: Callable[[int], None]) -> Iterator[bytes]:
    with path.open("rb") as file:
        file.seek(offset)
        while piece := file.read(OPTIONS.piece_bytes):
            yield piece
            offset += len(piece)
            report(offset)


def reason(answer: httpx.Response) -> str:
    """Return the sentence of an answer that refuses."""
    try:
        return str(answer.json()["detail"])
    except (ValueError, KeyError, TypeError):
        return f"The server answered {answer.status_code}."
