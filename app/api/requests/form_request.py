"""Forms whose file parts may come without a file name."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import aclosing
from typing import Any

from python_multipart.multipart import parse_options_header
from starlette.datastructures import FormData, Headers
from starlette.exceptions import HTTPException
from starlette.formparsers import MultiPartException, MultiPartParser
from starlette.requests import Request
from starlette.types import Receive, Scope


class FormRequest(Request):
    """A request whose form parts of the names `files` are files, with or without a file name.

    Without it a part that has no file name is text: bytes that are no text are lost, and it may have 1 MB at most.
    """

    def __init__(self, scope: Scope, receive: Receive, files: frozenset[str]) -> None:
        super().__init__(scope, receive)
        self._files = files

    async def _get_form(self, **limits: Any) -> FormData:
        if self._form is None and self._files and is_multipart(self.headers):
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


def is_multipart(headers: Headers) -> bool:
    """Whether a body is a multipart form; media types are compared without regard to case."""
    return media_type(headers) == "multipart/form-data"


def media_type(headers: Headers) -> str:
    """Return the media type of a body in lower case, without its parameters; empty when there is none."""
    return headers.get("content-type", "").partition(";")[0].strip().lower()
