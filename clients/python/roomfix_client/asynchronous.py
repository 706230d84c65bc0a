"""The client for programs that run an event loop; it streams too."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import AsyncIterable, AsyncIterator, Mapping
from types import TracebackType
from typing import Any, Self, cast

import httpx

from roomfix_client import calls
from roomfix_client.answers import (
    Build,
    Inspection,
    LocateResult,
    PushedFrame,
    Session,
    Token,
    TrackedFrame,
    Venue,
)
from roomfix_client.calls import Call, Frame, Picture, Progress, Scan
from roomfix_client.errors import BuildError


class AsyncRoomfix:
    """A server at an address, called with a key or token. Use it in an `async with` block, or call `close`.

    A call that meets a busy server, a limit of use or a broken connection is made again, `retries` times. Every method
    raises `RoomfixError` for what the server refuses.
    """

    def __init__(
        self, url: str, key: str | None = None, *, retries: int = 3, timeout_s: float = 60.0
    ) -> None:
        self._retries = retries
        self._url = url
        self._key = key
        self._client = httpx.AsyncClient(base_url=url, headers=calls.bearer(key), timeout=timeout_s)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the connections."""
        await self._client.aclose()

    async def locate(self, picture: Picture, **fields: Any) -> LocateResult:
        """Locate a picture: `venue`, `camera`, `gravity`, `axes`, `device_pose` and the other fields of `/locate`."""
        return cast(LocateResult, await self._call(calls.with_picture("/locate", picture, fields)))

    async def venues(self) -> list[Venue]:
        """Return the venues that the key may use."""
        return cast(list[Venue], await self._call(Call("GET", "/venues")))

    async def create_session(self, venue: str, **fields: Any) -> Session:
        """Start a session: `camera`, `destination`, `language`."""
        body = {"venue": venue, **fields}
        return cast(Session, await self._call(Call("POST", "/sessions", lambda: {"json": body})))

    async def track(self, session: str, picture: Picture, **fields: Any) -> TrackedFrame:
        """Track a frame of a session: `timestamp`, `motion`, `gravity`, `axes`, `device_pose`, `camera`."""
        return cast(
            TrackedFrame, await self._call(calls.with_picture(f"/sessions/{session}/frames", picture, fields))
        )

    async def stream(self, session: str, frames: AsyncIterable[Frame]) -> AsyncIterator[TrackedFrame]:
        """Send frames as they come and yield the answers; of frames that wait the server answers the newest.

        An answer to a frame that could not be used has `detail` and no `tracking`. It ends when the last frame is
        answered; what `frames` raises it raises too. Needs the extra `stream`.
        """
        from websockets.asyncio.client import connect
        from websockets.typing import Subprotocol

        offered = [Subprotocol(name) for name in calls.subprotocols(self._key)]
        async with connect(
            calls.stream_url(self._url, session), subprotocols=offered, max_size=None
        ) as socket:
            sent = answered = 0
            is_over = asyncio.Event()

            async def send() -> None:
                nonlocal sent
                try:
                    async for frame in frames:
                        if frame.fields:
                            await socket.send(json.dumps(dict(frame.fields)))
                        sent += 1
                        await socket.send(calls.picture_bytes(frame.picture))
                finally:
                    is_over.set()
                    # The loop below would wait for answers that never come.
                    if answered == sent or sys.exception() is not None:
                        await socket.close()

            sending = asyncio.create_task(send())
            try:
                async for text in socket:
                    answer = json.loads(text)
                    answered = answer.get("received", answered)
                    yield cast(TrackedFrame, answer)
                    if is_over.is_set() and answered == sent:
                        break
                if is_over.is_set():
                    await sending
            finally:
                sending.cancel()

    async def end_session(self, session: str) -> None:
        """End a session and delete where it went."""
        await self._call(Call("DELETE", f"/sessions/{session}"))

    async def create_token(self, venue: str | None = None, expires_in_s: float | None = None) -> Token:
        """Make a short-lived token for a phone."""
        body = {"venue": venue, "expires_in_s": expires_in_s}
        return cast(Token, await self._call(Call("POST", "/tokens", lambda: {"json": body})))

    async def push_anchor_frame(self, camera: str, picture: Picture) -> PushedFrame:
        """Push the newest frame of a monitoring camera."""
        return cast(
            PushedFrame, await self._call(calls.with_picture(f"/anchors/{camera}/frames", picture, {}))
        )

    async def inspect(
        self, archive: Scan, options: Mapping[str, Any] | None = None, on_upload: Progress | None = None
    ) -> Inspection:
        """Return what a scan holds and what a build would do with it."""
        return cast(Inspection, await self._call(calls.inspection(archive, options or {}, on_upload)))

    async def build(
        self,
        archive: Scan,
        venue: str,
        options: Mapping[str, Any],
        on_upload: Progress | None = None,
    ) -> Build:
        """Submit a scan and return its build, which is queued; `on_upload` gets the bytes sent and their sum."""
        submitted = await self._call(calls.submission(archive, venue, options, on_upload))
        return await self.build_status(submitted["build"])

    async def build_status(self, build: str) -> Build:
        """Return where a build is."""
        return cast(Build, await self._call(Call("GET", f"/database/builds/{build}")))

    async def wait_for_build(self, build: str, every_s: float = 1.0) -> Build:
        """Return a build when it has succeeded; raises `BuildError` when it has not."""
        while (status := await self.build_status(build))["state"] in ("queued", "running"):
            await asyncio.sleep(every_s)
        if status["state"] != "succeeded":
            raise BuildError(status["error"] or f"The build was {status['state']}.")
        return status

    async def _call(self, call: Call) -> Any:
        for attempt in range(self._retries + 1):
            try:
                return calls.checked(await self._client.request(call.method, call.path, **call.options()))
            except Exception as error:
                pause_s = calls.pause_s(error, attempt)
                if pause_s is None or attempt == self._retries:
                    raise
                await asyncio.sleep(pause_s)
        raise AssertionError("the loop returns or raises")
