"""Large answers that are made by a few threads of their own, once for all who ask for the same."""

from __future__ import annotations

import asyncio
import gzip
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

from fastapi import Request, Response

from app.api.executor import BoundedExecutor
from app.api.requests.conditional import is_known, unless_known
from app.limits import limit
from app.lru import LruCache

Result = TypeVar("Result")


@dataclass(frozen=True, slots=True, kw_only=True)
class DrawingOptions:
    """How much is drawn at once, and how much of it is kept."""

    threads: int = limit(
        1,
        "Threads that draw maps and plans.",
        chosen="By hand: a page can wait, and queries keep the other cores.",
    )
    waiting: int = limit(
        128,
        "Drawings that may wait before 503.",
        chosen="By hand: some pages full of pictures of keyframes, which take 10 ms each.",
    )
    kept_bytes: int = limit(
        64_000_000,
        "Sum of the sizes of the drawings that are kept in memory, those used last.",
        chosen="By hand: some tens of maps, since a page asks for the same points again and again.",
    )
    gzip_level: int = limit(
        4, "Level of gzip of what is kept, 1 to 9.", chosen="By hand: as that of other answers."
    )


OPTIONS = DrawingOptions()


@dataclass(frozen=True, slots=True)
class Drawing:
    """The bytes of an answer, as they are and compressed. All answers that are being written share them."""

    plain: bytes
    packed: bytes

    @property
    def size(self) -> int:
        """Bytes of memory."""
        return len(self.plain) + len(self.packed)

    def response(self, request: Request, media_type: str) -> Response:
        """Return the answer in the form that the client takes."""
        headers = {"Vary": "Accept-Encoding"}
        if "gzip" not in request.headers.get("accept-encoding", ""):
            return Response(self.plain, media_type=media_type, headers=headers)
        return Response(self.packed, media_type=media_type, headers={**headers, "Content-Encoding": "gzip"})


class Drawings:
    """Makes large answers outside of the threads that answer everything else. Of one event loop."""

    def __init__(self, options: DrawingOptions = OPTIONS) -> None:
        self._options = options
        self._executor = BoundedExecutor(options.threads, options.waiting)
        self._kept: LruCache[str, Drawing] = LruCache(options.kept_bytes, lambda drawing: drawing.size + 1)
        self._making: dict[str, asyncio.Task[Drawing]] = {}

    async def run(self, function: Callable[[], Result]) -> Result:
        """Return what a call returns; raises `BusyError` when too many wait."""
        return await self._executor.run(function)

    async def answer(
        self, request: Request, digest: str, make: Callable[[], bytes], media_type: str
    ) -> Response:
        """Return the answer whose content has a digest: 304 when the client has it, else as `get`."""
        if is_known(request, digest):
            return unless_known(request, digest, Response)
        drawing = await self.get(digest, make)
        return unless_known(request, digest, lambda: drawing.response(request, media_type))

    async def get(self, digest: str, make: Callable[[], bytes]) -> Drawing:
        """Return the drawing with a digest, which is made unless it is kept or being made; raises as `run`."""
        kept = self._kept.get(digest)
        if kept is not None:
            return kept
        making = self._making.get(digest)
        if making is None:
            making = asyncio.create_task(self.run(partial(self._made, make)))
            self._making[digest] = making
            making.add_done_callback(partial(self._end, digest))
        # The client that asked first may go, the others wait on.
        return await asyncio.shield(making)

    def close(self) -> None:
        """Wait for what is drawn and drop what waits."""
        self._executor.close()

    def _made(self, make: Callable[[], bytes]) -> Drawing:
        plain = make()
        return Drawing(plain, gzip.compress(plain, self._options.gzip_level, mtime=0))

    def _end(self, digest: str, making: asyncio.Task[Drawing]) -> None:
        del self._making[digest]
        if not making.cancelled() and making.exception() is None:
            self._kept.put(digest, making.result())
