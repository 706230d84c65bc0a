"""The client for programs that wait for answers."""

from __future__ import annotations

import time
from collections.abc import Mapping
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
from roomfix_client.calls import Call, Picture, Progress, Scan
from roomfix_client.errors import BuildError


class Roomfix:
    """A server at an address, called with a key or token. Use it in a `with` block, or call `close`.

    A call that meets a busy server, a limit of use or a broken connection is made again, `retries` times. Every method
    raises `RoomfixError` for what the server refuses.
    """

    def __init__(
        self, url: str, key: str | None = None, *, retries: int = 3, timeout_s: float = 60.0
    ) -> None:
        self._retries = retries
        self._client = httpx.Client(base_url=url, headers=calls.bearer(key), timeout=timeout_s)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._client.close()

    def locate(self, picture: Picture, **fields: Any) -> LocateResult:
        """Locate a picture: `venue`, `camera`, `gravity`, `axes`, `device_pose` and the other fields of `/locate`."""
        return cast(LocateResult, self._call(calls.with_picture("/locate", picture, fields)))

    def venues(self) -> list[Venue]:
        """Return the venues that the key may use."""
        return cast(list[Venue], self._call(Call("GET", "/venues")))

    def create_session(self, venue: str, **fields: Any) -> Session:
        """Start a session: `camera`, `destination`, `language`."""
        body = {"venue": venue, **fields}
        return cast(Session, self._call(Call("POST", "/sessions", lambda: {"json": body})))

    def track(self, session: str, picture: Picture, **fields: Any) -> TrackedFrame:
        """Track a frame of a session: `timestamp`, `motion`, `gravity`, `axes`, `device_pose`, `camera`."""
        return cast(
            TrackedFrame, self._call(calls.with_picture(f"/sessions/{session}/frames", picture, fields))
        )

    def end_session(self, session: str) -> None:
        """End a session and delete where it went."""
        self._call(Call("DELETE", f"/sessions/{session}"))

    def create_token(self, venue: str | None = None, expires_in_s: float | None = None) -> Token:
        """Make a short-lived token for a phone."""
        body = {"venue": venue, "expires_in_s": expires_in_s}
        return cast(Token, self._call(Call("POST", "/tokens", lambda: {"json": body})))

    def push_anchor_frame(self, camera: str, picture: Picture) -> PushedFrame:
        """Push the newest frame of a monitoring camera."""
        return cast(PushedFrame, self._call(calls.with_picture(f"/anchors/{camera}/frames", picture, {})))

    def inspect(
        self, archive: Scan, options: Mapping[str, Any] | None = None, on_upload: Progress | None = None
    ) -> Inspection:
        """Return what a scan holds and what a build would do with it."""
        return cast(Inspection, self._call(calls.inspection(archive, options or {}, on_upload)))

    def build(
        self,
        archive: Scan,
        venue: str,
        options: Mapping[str, Any],
        on_upload: Progress | None = None,
    ) -> Build:
        """Submit a scan and return its build, which is queued; `on_upload` gets the bytes sent and their sum."""
        submitted = self._call(calls.submission(archive, venue, options, on_upload))
        return self.build_status(submitted["build"])

    def build_status(self, build: str) -> Build:
        """Return where a build is."""
        return cast(Build, self._call(Call("GET", f"/database/builds/{build}")))

    def wait_for_build(self, build: str, every_s: float = 1.0) -> Build:
        """Return a build when it has succeeded; raises `BuildError` when it has not."""
        while (status := self.build_status(build))["state"] in ("queued", "running"):
            time.sleep(every_s)
        if status["state"] != "succeeded":
            raise BuildError(status["error"] or f"The build was {status['state']}.")
        return status

    def _call(self, call: Call) -> Any:
        for attempt in range(self._retries + 1):
            try:
                return calls.checked(self._client.request(call.method, call.path, **call.options()))
            except Exception as error:
                pause_s = calls.pause_s(error, attempt)
                if pause_s is None or attempt == self._retries:
                    raise
                time.sleep(pause_s)
        raise AssertionError("the loop returns or raises")
