"""The table of docs/keys.md as data, and what a matrix of keys needs: calls with real ids in their paths."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fastapi.routing import APIRoute, APIWebSocketRoute
from fastapi.testclient import TestClient
from starlette.testclient import WebSocketDenialResponse

from app.api.deps import AppState
from app.errors import NotFoundError
from app.services.keys.caller import OPEN
from app.services.keys.key_service import NewKey
from app.storage import builds
from tests.scenes import CAMERA_TEXT
from tests.server import Server

PAGE = Path(__file__).parents[2] / "docs" / "keys.md"
VENUE = "museum"
OTHER = "hotel"
CAMERA = "hall-camera"
POI = {
    "id": "sign",
    "region_px": [[10, 10], [60, 10], [60, 60], [10, 60]],
    "position": {"x": 3, "y": 1},
    "distance_m": 2.5,
}
ANCHOR = {
    "venue": VENUE,
    "floor": "0",
    "position": {"x": 1, "y": 1},
    "height_m": 2,
    "camera": {"model": "PINHOLE", "width": 640, "height": 480, "params": [500, 500, 320, 240]},
    "pois": [POI],
}
FLOOR = {"name": "Ground", "level": 0, "z_min_m": -1, "z_max_m": 3}
# Bodies of calls whose venue is in the body: without a valid one they would not come to the check.
BODIES: dict[str, dict[str, Any]] = {
    "POST /locate": {"data": {"venue": VENUE}, "files": {"image": b"no picture"}},
    "POST /database/build": {
        "data": {"venue": VENUE, "options": json.dumps({"camera": CAMERA_TEXT})},
        "files": {"archive": b"no archive"},
    },
    "POST /database/calibrate": {"data": {"venue": VENUE}, "files": {"archive": b"no archive"}},
    "POST /venues/import": {"files": {"archive": b"no file of a venue"}},
    "POST /database/inspect": {"files": {"archive": b"no archive"}},
    "POST /oscp/geopose": {
        "params": {"venue": VENUE},
        "json": {"id": "1", "sensorReadings": {"cameraReadings": [{"imageBytes": ""}]}},
    },
    "POST /sessions": {"json": {"venue": VENUE}},
    "POST /keys": {"json": {"name": "another", "scope": "locate", "venue": VENUE}},
    "POST /tokens": {"json": {"venue": VENUE}},
    "POST /venues": {"json": {"id": "further", "name": "Further"}},
    "PUT /anchors/{camera}": {"json": ANCHOR},
    "POST /recordings": {"json": {"venue": VENUE}},
    "PUT /recordings/{recording}/frames/{number}": {"params": {"time_s": 0}, "content": b"no picture"},
    "POST /recordings/{recording}/finish": {"json": {"frames": 9}},
    "POST /uploads": {"headers": {"Tus-Resumable": "1.0.0", "Upload-Length": "10"}},
    "HEAD /uploads/{upload}": {"headers": {"Tus-Resumable": "1.0.0"}},
    "PATCH /uploads/{upload}": {"headers": {"Tus-Resumable": "1.0.0", "Upload-Offset": "0"}},
    "DELETE /uploads/{upload}": {"headers": {"Tus-Resumable": "1.0.0"}},
}


@dataclass(frozen=True, slots=True)
class Row:
    """A row of the table: a call, and by column what becomes of it."""

    call: str
    cells: dict[str, str]


def rows() -> list[Row]:
    """Return the table of docs/keys.md."""
    lines = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    start = next(i for i, line in enumerate(lines) if line.startswith("| call | no key |"))
    head, *body = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[start:]]
    cells = [row for row in body if not row[0].startswith("---") and row[0].startswith("`")]
    return [Row(row[0].strip("`"), dict(zip(head[1:], row[1:], strict=True))) for row in cells]


def calls(app: Any) -> Iterator[str]:
    """Yield `METHOD /path` of every route of an app that clients may call, WebSockets included."""
    for route in app.routes:
        if hasattr(route, "original_router"):
            yield from calls(route.original_router)
        elif isinstance(route, APIWebSocketRoute):
            yield f"WS {route.path}"
        elif isinstance(route, APIRoute) and route.include_in_schema:
            yield from (f"{method} {route.path}" for method in sorted(route.methods))


class Callers:
    """A server with two venues, and keys and calls made afresh, since a call may delete what the next one needs."""

    def __init__(self, server: Server, admin_key: str) -> None:
        assert isinstance(server.client, TestClient)
        self.client = server.client
        self.state: AppState = server.client.app.state.roomfix  # type: ignore[attr-defined]
        self._upload: str | None = None
        self._admin = {"Authorization": f"Bearer {admin_key}"}

    def key(self, column: str) -> str | None:
        """Return the key of a column."""
        if column == "no key":
            return None
        scope, venue, camera = {
            "locate": ("locate", VENUE, None),
            "anchor": ("anchor", VENUE, CAMERA),
            "admin": ("admin", None, None),
            "token": ("locate", VENUE, None),
            "record": ("record", VENUE, None),
            "other venue": ("admin", OTHER, None),
            "other camera": ("anchor", VENUE, "another-camera"),
            "expired": ("admin", None, None),
            "revoked": ("admin", None, None),
        }[column]
        made = self.make(scope, venue, camera)
        if column == "token":
            return self.state.services.keys.create_token(OPEN, VENUE).text
        if column == "revoked":
            self.state.services.keys.revoke(OPEN, made.key.id)
        if column == "expired":
            self.expire(made.key.id)
        return made.text

    def make(self, scope: Any, venue: str | None = None, camera: str | None = None) -> NewKey:
        """Make a key."""
        return self.state.services.keys.create(OPEN, "a key", scope, venue, camera_id=camera)

    def expire(self, key_id: str) -> None:
        """Let a key end an hour ago."""
        with self.state.services.resources.database.write() as connection:
            connection.exec_driver_sql(
                f"UPDATE keys SET expires_at = '2020-01-01 00:00:00.000000' WHERE id = '{key_id}'"
            )

    def prepare(self) -> dict[str, str]:
        """Return values for the names in paths, of things that are there."""
        for venue in (VENUE, OTHER):
            self.client.post("/venues", json={"id": venue, "name": venue}, headers=self._admin)
        for path, body in (("floors/0", FLOOR),):
            self.client.put(f"/venues/{VENUE}/{path}", json=body, headers=self._admin)
        self.client.put(f"/anchors/{CAMERA}", json=ANCHOR, headers=self._admin)
        self.client.delete("/venues/further", headers=self._admin)
        with self.state.services.resources.database.write() as connection:
            build = builds.create_build(connection, VENUE, {}, "0" * 64)
            # Ended, so that its events end too.
            builds.cancel_build(connection, build)
        session = self.state.services.sessions.create(VENUE).id
        recording = self.state.services.recordings.begin(VENUE).recording.id
        key = self.make("locate", VENUE).key.id
        return {
            "venue": VENUE, "floor": "0", "session": session, "build": build, "camera": CAMERA, "key": key,
            "version": "1", "keyframe": "0", "picture": "0", "recording": recording, "number": "0",
            "zoom": "0", "column": "0", "row": "0",
            "upload": self._begun_upload(),
        }  # fmt: skip

    def _begun_upload(self) -> str:
        uploads = self.state.services.uploads
        if self._upload is not None:
            with suppress(NotFoundError):
                return uploads.get(self._upload).id
        self._upload = uploads.create(10, VENUE).id
        return self._upload

    def call(self, call: str, column: str) -> tuple[int, str]:
        """Make a call with a column's key and return status and body; 101 for a WebSocket that was opened."""
        values = self.prepare()
        method, template = call.split(" ", 1)
        path = re.sub(r"{(\w+)}", lambda match: values[match[1]], template)
        key = self.key(column)
        headers = {"Authorization": f"Bearer {key}"} if key else {}
        if method == "WS":
            try:
                with self.client.websocket_connect(f"ws://127.0.0.1{path}", headers=headers):
                    return 101, ""
            except WebSocketDenialResponse as refused:
                return refused.status_code, refused.text
        arguments = dict(BODIES.get(call, {}))
        headers |= arguments.pop("headers", {})
        answer = self.client.request(method, path, headers=headers, **arguments)
        return answer.status_code, answer.text
