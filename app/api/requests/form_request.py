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

from app.api.requests.names import shown
from app.api.requests.read_json import read_json
from app.errors import InvalidInputError

# Files of a form that a plain picture or JSON may stand for.
PICTURE = frozenset({"image"})
# Files that a form of a picture may have beside it; in JSON they are a list.
FURTHER = frozenset({"images"})
JSON_MEDIA_TYPE = "application/json"
# What pages write before a picture (`canvas.toDataURL`): its first characters, and the last ones before the comma.
DATA_URL_BEGINS = "data:"
DATA_URL_ENDS = ";base64"
URL_SAFE = str.maketrans("-_", "+/")
NOT_FORM_DATA = (
    "The form can't be read: each of its parts must begin with the boundary that Content-Type names, and lines must "
    "end with CR LF. Let the HTTP library write Content-Type."
)


class FormRequest(Request):
    """A request whose form parts of the names `files` are files and those of `texts` are text, with or without a file
    name.

    Without it a part that has no file name is text: bytes that are no text are lost, and it may have 1 MB at most; and
    one that has a file name, as a `Blob` of JSON, is a file.
    Where the only file is the picture `image`, further `images` aside, the body may also be the picture itself, with
    the other fields in the query, or JSON that holds it as base64 beside the other fields.
    """

    def __init__(
        self, scope: Scope, receive: Receive, files: frozenset[str], texts: frozenset[str] = frozenset()
    ) -> None:
        super().__init__(scope, receive)
        self._files = files
        self._texts = texts

    async def json(self) -> Any:
        """Return the JSON of the body; raises `HTTPException`."""
        return _json_of(await self.body())

    async def _get_form(self, **limits: Any) -> FormData:
        if self._form is None and is_picture(self._files) and is_raw(self.headers):
            self._form = FormData([*self.query_params.multi_items(), ("image", _file(await self.body()))])
        elif self._form is None and is_picture(self._files) and media_type(self.headers) == JSON_MEDIA_TYPE:
            self._form = form_of_json(await self.body())
        elif self._form is None and self._files and is_multipart(self.headers):
            try:
                async with aclosing(self.stream()) as stream:
                    parser = FilePartParser(self.headers, stream, self._files, self._texts, **limits)
                    self._form = await parser.parse()
            except MultiPartException as error:
                # The parser's own words for all that is no form name nothing to change.
                sentence = NOT_FORM_DATA if error.message.startswith("Invalid") else error.message
                raise HTTPException(400, sentence) from None
        return await super()._get_form(**limits)


class FilePartParser(MultiPartParser):
    """Reads a multipart form; whether a part is a file or text depends on its name, where that is known."""

    def __init__(
        self,
        headers: Headers,
        stream: AsyncGenerator[bytes, None],
        files: frozenset[str],
        texts: frozenset[str],
        **limits: Any,
    ) -> None:
        super().__init__(headers, stream, **limits)
        self._files = files
        self._texts = texts

    def on_headers_finished(self) -> None:
        """Give a file without a file name the name of its field, and take it from a text."""
        part = self._current_part
        _, options = parse_options_header(part.content_disposition)
        name = options.get(b"name", b"").decode("latin-1")
        if name in self._files and b"filename" not in options:
            part.content_disposition = (part.content_disposition or b"") + b'; filename="%s"' % name.encode()
        if name in self._texts and b"filename" in options:
            part.content_disposition = b'form-data; name="%s"' % name.encode()
        encoding = dict(part.item_headers).get(b"content-transfer-encoding", b"").strip().lower()
        if encoding in (b"base64", b"quoted-printable"):
            raise MultiPartException(
                f"{shown(name)}: the part is encoded (Content-Transfer-Encoding: {encoding.decode()}); send its bytes "
                "as they are."
            )
        super().on_headers_finished()

    def on_part_data(self, data: bytes, start: int, end: int) -> None:
        """Take some bytes of a part; a text that is too long is refused by its name."""
        part = self._current_part
        if part.file is None and len(part.data) + end - start > self.max_part_size:
            raise MultiPartException(
                f"{shown(part.field_name)}: a text of a form has at most {self.max_part_size:,} bytes. Is it a file?"
            )
        super().on_part_data(data, start, end)


def _json_of(body: bytes) -> Any:
    """Return the JSON of a body; raises `HTTPException`, for FastAPI makes a 400 without a reason of other errors."""
    try:
        return read_json(body)
    except InvalidInputError as error:
        raise HTTPException(422, str(error)) from None


def form_of_json(body: bytes) -> FormData:
    """Return the form that a JSON object stands for: `image` is base64, `images` a list of such; other values are
    written as a form has them.

    Raises `HTTPException` for anything else.
    """
    values = _json_of(body)
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
    """Return the bytes of a picture in base64: in lines, as some encoders write it, of the alphabet for URLs, without
    padding, or behind the prefix of a data URL too."""
    text = value if isinstance(value, str) else "?"
    prefix, comma, rest = text.partition(",")
    named = prefix.strip().lower()
    if comma and named.startswith(DATA_URL_BEGINS) and named.endswith(DATA_URL_ENDS):
        text = rest
    packed = "".join(text.split()).translate(URL_SAFE).rstrip("=")
    try:
        return base64.b64decode(packed + "=" * (-len(packed) % 4), validate=True)
    except ValueError:
        raise HTTPException(422, "image must be a picture as base64.") from None


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
