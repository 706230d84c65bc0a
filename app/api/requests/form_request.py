"""Forms whose file parts may come without a file name, and what may stand for a form: a plain picture, or JSON."""

from __future__ import annotations

import base64
import json
from collections.abc import AsyncGenerator
from contextlib import aclosing
from io import BytesIO
from typing import Any

from python_multipart.multipart import parse_options_header
from starlette.datastructures import FormData, Headers, UploadFile
from starlette.exceptions import HTTPException
from starlette.formparsers import MultiPartException, MultiPartParser
from starlette.requests import Request
from starlette.types import Receive, Scope

# Files of a form that a plain picture or JSON may stand for.
PICTURE = frozenset({"image"})
# Files that a form of a picture may have beside it; in JSON they are a list.
FURTHER = frozenset({"images"})
JSON_MEDIA_TYPE = "application/json"


class FormRequest(Request):
    """A request whose form parts of the names `files` are files, with or without a file name.

    Without it a part that has no file name is text: bytes that are no text are lost, and it may have 1 MB at most.
    Where the only file is the picture `image`, further `images` aside, the body may also be the picture itself, with
    the other fields in the query, or JSON that holds it as base64 beside the other fields.
    """

    def __init__(self, scope: Scope, receive: Receive, files: frozenset[str]) -> None:
        super().__init__(scope, receive)
        self._files = files

    async def _get_form(self, **limits: Any) -> FormData:
        if self._form is None and is_picture(self._files) and is_raw(self.headers):
            self._form = FormData([*self.query_params.multi_items(), ("image", _file(await self.body()))])
        elif self._form is None and is_picture(self._files) and media_type(self.headers) == JSON_MEDIA_TYPE:
            self._form = form_of_json(await self.body())
        elif self._form is None and self._files and is_multipart(self.headers):
            try:
                async with aclosing(self.stream()) as stream:
                    self._form = await FilePartParser(self.headers, stream, self._files, **limits).parse()
            except MultiPartException as error:
                raise HTTPException(400, error.message) from None
        return await super()._get_form(**limits)


class FilePartParser(MultiPartParser):
    """Reads a multipart form; a part with the name of a file is one even without a file name."""

    def __init__(
        self, headers: Headers, stream: AsyncGenerator[bytes, None], files: frozenset[str], **limits: Any
    ) -> None:
        super().__init__(headers, stream, **limits)
        self._files = files

    def on_headers_finished(self) -> None:
        """Give a file without a file name the name of its field."""
        part = self._current_part
        _, options = parse_options_header(part.content_disposition)
        name = options.get(b"name", b"").decode("latin-1")
        if name in self._files and b"filename" not in options:
            part.content_disposition = (part.content_disposition or b"") + b'; filename="%s"' % name.encode()
        super().on_headers_finished()


def form_of_json(body: bytes) -> FormData:
    """Return the form that a JSON object stands for: `image` is base64, `images` a list of such; other values are
    written as a form has them.

    Raises `HTTPException` for anything else.
    """
    try:
        values = json.loads(body)
    except (ValueError, RecursionError):
        raise HTTPException(422, "The body is not JSON.") from None
    if not isinstance(values, dict):
        raise HTTPException(
            422, "The body must be a JSON object with image, as base64, and the other fields."
        )
    fields: list[tuple[str, str | UploadFile]] = []
    for name, value in values.items():
        if name == "image":
            fields.append((name, _file(_decoded(value))))
        elif name in FURTHER and isinstance(value, list):
            fields += [(name, _file(_decoded(each))) for each in value]
        elif value is not None:
            fields.append((name, _as_text(value)))
    return FormData(fields)


def is_picture(files: frozenset[str]) -> bool:
    """Whether the files of a form are a picture, and perhaps further ones."""
    return PICTURE <= files <= PICTURE | FURTHER


def _decoded(value: object) -> bytes:
    try:
        return base64.b64decode(value if isinstance(value, str) else "?", validate=True)
    except ValueError:
        raise HTTPException(422, "image must be a picture as base64, without a prefix.") from None


def _as_text(value: object) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, list) and all(isinstance(each, int | float) for each in value):
        return ",".join(repr(each) for each in value)
    return json.dumps(value)


def _file(data: bytes) -> UploadFile:
    return UploadFile(BytesIO(data), size=len(data), filename="image")


def is_raw(headers: Headers) -> bool:
    """Whether a body is a picture itself."""
    kind = media_type(headers)
    return kind.startswith("image/") or kind == "application/octet-stream"


def is_multipart(headers: Headers) -> bool:
    """Whether a body is a multipart form; media types are compared without regard to case."""
    return media_type(headers) == "multipart/form-data"


def media_type(headers: Headers) -> str:
    """Return the media type of a body in lower case, without its parameters; empty when there is none."""
    return headers.get("content-type", "").partition(";")[0].strip().lower()
