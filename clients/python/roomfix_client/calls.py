"""What calls send, and when they are sent again; the same for both clients."""

from __future__ import annotations

import json
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from os import SEEK_END, PathLike
from pathlib import Path
from typing import Any, BinaryIO

import httpx

from roomfix_client.errors import RoomfixError, error_of

Picture = bytes | str | PathLike[str]
Progress = Callable[[int, int], None]
# Of a busy server, of a limit of use, and of a proxy whose server restarts.
PASSING = (429, 502, 503, 504)
FIRST_PAUSE_S = 0.5
LONGEST_PAUSE_S = 30.0
# Fields with one entry for each of several frames.
LISTS = ("motion", "cameras")


@dataclass(frozen=True, slots=True)
class Frame:
    """A frame of a stream and what is known of it, as `track` takes it."""

    picture: Picture
    fields: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Uploaded:
    """A scan that a tus client has uploaded: the id is the end of the upload's address."""

    upload: str


# A file, or what was uploaded before.
Scan = str | PathLike[str] | Uploaded


@dataclass(frozen=True, slots=True)
class Call:
    """A call that can be made again; `options` makes the arguments of httpx anew, since files are read once."""

    method: str
    path: str
    options: Callable[[], dict[str, Any]] = dict


def bearer(key: str | None) -> dict[str, str]:
    """Return the header of a key or token."""
    return {"Authorization": f"Bearer {key}"} if key else {}


def picture_bytes(picture: Picture) -> bytes:
    """Return a picture's bytes, read from its file if it is a path."""
    return picture if isinstance(picture, bytes) else Path(picture).read_bytes()


def form(fields: Mapping[str, Any]) -> dict[str, str]:
    """Return the fields of a form: None is left out, numbers are joined by commas, all else is JSON."""
    return {
        name: json.dumps(list(value))
        if name in LISTS and not isinstance(value, str | Mapping)
        else _text(value)
        for name, value in fields.items()
        if value is not None
    }


def _text(value: Any) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, list | tuple):
        return ",".join(str(part) for part in value)
    return json.dumps(value)


def with_picture(path: str, picture: Picture, fields: Mapping[str, Any]) -> Call:
    """Return a call whose form has a picture, and the further ones of the field `images`."""
    further = [picture_bytes(each) for each in fields.get("images") or ()]
    files = [("image", ("image", picture_bytes(picture)))]
    files += [("images", ("image", data)) for data in further]
    data = form({name: value for name, value in fields.items() if name != "images"})
    return Call("POST", path, lambda: {"data": data, "files": files})


def submission(scan: Scan, venue: str, options: Mapping[str, Any], on_progress: Progress | None) -> Call:
    """Return the call that submits a scan; sent again, it is the same build."""
    headers, fields = (
        {"Idempotency-Key": uuid.uuid4().hex},
        {"venue": venue, **form({"options": dict(options)})},
    )
    return Call(
        "POST", "/database/build", lambda: {**_with_scan(scan, fields, on_progress), "headers": headers}
    )


def inspection(scan: Scan, options: Mapping[str, Any], on_progress: Progress | None) -> Call:
    """Return the call that asks what a scan holds."""
    fields = form({"options": dict(options)})
    return Call("POST", "/database/inspect", lambda: _with_scan(scan, fields, on_progress))


def _with_scan(scan: Scan, fields: dict[str, str], on_progress: Progress | None) -> dict[str, Any]:
    if isinstance(scan, Uploaded):
        return {"data": {**fields, "upload": scan.upload}}
    return {"data": fields, "files": {"archive": (Path(scan).name, CountedFile(Path(scan), on_progress))}}


class CountedFile:
    """A file to upload that says how much of it has been read."""

    def __init__(self, path: Path, on_progress: Progress | None) -> None:
        self._file: BinaryIO = path.open("rb")
        self._total = self._file.seek(0, SEEK_END)
        self._file.seek(0)
        self._on_progress = on_progress

    def read(self, size: int = -1) -> bytes:
        """Return the next bytes."""
        data = self._file.read(size)
        if self._on_progress is not None and data:
            self._on_progress(self._file.tell(), self._total)
        if not data:
            self._file.close()
        return data

    def seek(self, offset: int, whence: int = 0) -> int:
        """Move to a place in the file."""
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """Return the place in the file."""
        return self._file.tell()


def pause_s(error: Exception, attempt: int) -> float | None:
    """Return how long to wait before a call is made again, None for one that would fail again."""
    backoff_s = min(FIRST_PAUSE_S * 2.0**attempt, LONGEST_PAUSE_S)
    if isinstance(error, httpx.TransportError):
        return backoff_s
    if isinstance(error, RoomfixError) and error.status in PASSING:
        return backoff_s if error.retry_after_s is None else min(error.retry_after_s, LONGEST_PAUSE_S)
    return None


def checked(answer: httpx.Response) -> Any:
    """Return the JSON of an answer, None of an empty one; raises `RoomfixError`."""
    if not answer.is_success:
        raise error_of(answer)
    return answer.json() if answer.content else None


def stream_url(base_url: str, session: str) -> str:
    """Return the address of a session's stream."""
    return f"{base_url.rstrip('/').replace('http', 'ws', 1)}/sessions/{session}/stream"


def subprotocols(key: str | None) -> list[str]:
    """Return what a WebSocket offers, with the key in it."""
    return ["roomfix", f"roomfix.key.{key}"] if key else ["roomfix"]
