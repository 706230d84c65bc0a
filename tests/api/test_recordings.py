"""Recordings over HTTP: frames that arrive in any order and more than once, an end that is said twice, who may."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest

from app.importers.frames import ScanOptions
from app.importers.registry import open_unposed
from app.jobs.handlers import drop_old_recordings
from app.jobs.runner import NoRunner
from app.services.keys.caller import OPEN
from app.services.resources import Resources
from app.storage.builds import claim_build, finish_build, get_build
from app.storage.check import blob_uses
from app.storage.db import now
from app.storage.recordings import touch
from tests.api.key_rows import Callers
from tests.scenes import encode
from tests.server import Server, assert_problem, running

VENUE = "museum"
COUNT = 4


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Server]:
    with running(tmp_path, NoRunner(), admin_key="the-key-of-the-settings") as server:
        server.client.headers["Authorization"] = "Bearer the-key-of-the-settings"
        server.client.post("/venues", json={"id": VENUE, "name": "Museum"}).raise_for_status()
        yield server


def resources(server: Server) -> Resources:
    found: Resources = server.client.app.state.roomfix.services.resources  # type: ignore[attr-defined]
    return found


def picture(number: int) -> bytes:
    return encode(np.full((96, 128, 3), 40 * number % 256, np.uint8), ".jpg")


def begin(server: Server) -> str:
    return str(server.client.post("/recordings", json={"venue": VENUE}).json()["recording"])


def put(server: Server, recording: str, number: int, data: bytes | None = None, **query: str) -> int:
    answer = server.client.put(
        f"/recordings/{recording}/frames/{number}",
        params={"time_s": str(0.5 * number), **query},
        content=picture(number) if data is None else data,
        headers={"Content-Type": "image/jpeg"},
    )
    return answer.status_code


def finish(
    server: Server, recording: str, frames: int = COUNT, **body: object
) -> tuple[int, dict[str, object]]:
    answer = server.client.post(f"/recordings/{recording}/finish", json={"frames": frames, **body})
    return answer.status_code, answer.json()


def test_frames_in_any_order_become_one_build_however_often_it_is_said(
    server: Server, tmp_path: Path
) -> None:
    recording = begin(server)
    for number in (2, 0, 3, 0):
        assert put(server, recording, number, gravity="0,2,0" if number != 3 else "") == 200
    state = server.client.get(f"/recordings/{recording}").json()
    assert (state["frames"], state["missing"], state["build"]) == (3, [1], None)
    status, refused = finish(server, recording)
    assert status == 409
    assert "Missing are: 1." in str(refused["detail"])
    assert put(server, recording, 1, picture(0)) == 200
    assert put(server, recording, 1) == 409

    status, body = finish(server, recording, scale={"marker_m": 0.16})
    assert status == 202
    build_id = body["build"]["build"]  # type: ignore[index]
    assert finish(server, recording, scale={"marker_m": 0.16})[1]["build"] == body["build"]
    assert put(server, recording, 4) == 409
    with resources(server).database.read() as connection:
        build = get_build(connection, build_id)
    assert build.options == {"format": "recording", "mode": "replace", "scale": {"marker_m": 0.16}}

    folder = tmp_path / "unpacked"
    with zipfile.ZipFile(io.BytesIO(resources(server).blobs.get(build.archive_blob))) as archive:
        archive.extractall(folder)
    unposed = open_unposed(folder, "auto", ScanOptions())
    assert unposed is not None
    assert unposed.format == "recording"
    assert [frame.time_s for frame in unposed.recorded] == [0.0, 0.5, 1.0, 1.5]
    assert [frame.down for frame in unposed.recorded] == [(0.0, 1.0, 0.0), None, (0.0, 1.0, 0.0), None]
    assert unposed.photos[2].read_bytes() == picture(2)


def test_a_build_that_failed_is_made_again_with_another_scale(server: Server) -> None:
    recording = begin(server)
    for number in range(COUNT):
        put(server, recording, number)
    _, first = finish(server, recording, scale={"marker_m": 0.16})
    with resources(server).database.write() as connection:
        claimed = claim_build(connection)
        assert claimed is not None
        finish_build(connection, claimed.id, "failed", error_code="invalid_scan", error="No marker was seen.")
    state = server.client.get(f"/recordings/{recording}").json()
    assert (state["build"]["state"], state["build"]["error"]) == ("failed", "No marker was seen.")
    _, second = finish(server, recording)
    assert second["build"]["build"] != first["build"]["build"]  # type: ignore[index]
    assert second["build"]["state"] == "queued"  # type: ignore[index]
    assert second["build"]["left_out"] == {}  # type: ignore[index]
    report = {"discarded": {"unconnected": 2}}
    with resources(server).database.write() as connection:
        claimed = claim_build(connection)
        assert claimed is not None
        finish_build(connection, claimed.id, "succeeded", report=report, map_version=1)
    state = server.client.get(f"/recordings/{recording}").json()
    assert (state["build"]["state"], state["build"]["left_out"]) == ("succeeded", {"unconnected": 2})


def test_what_is_wrong_is_said(server: Server) -> None:
    recording = begin(server)
    assert put(server, recording, 0, b"no picture") == 415
    assert put(server, recording, 0, picture(0)[:60]) == 422
    assert put(server, recording, 0, gravity="down") == 422
    assert put(server, recording, 1500) == 409
    assert put(server, "0" * 32, 0) == 404
    status, body = finish(server, recording, frames=1, scale={"marker_m": -1})
    assert (status, body["code"]) == (422, "invalid_input")
    assert_problem(server.client.post("/recordings", json={"venue": "nowhere"}), 404)
    assert_problem(server.client.post("/recordings", json={}), 422)


def test_frames_are_kept_as_long_as_they_are_needed(server: Server) -> None:
    recording, given_up, discarded = begin(server), begin(server), begin(server)
    for number in range(COUNT):
        put(server, recording, number)
    put(server, given_up, 0, picture(5))
    put(server, discarded, 0, picture(6))
    assert server.client.delete(f"/recordings/{discarded}").status_code == 204
    store = resources(server)
    with store.database.read() as connection:
        assert store.blobs.digests() == set(blob_uses(connection))
        assert len(store.blobs.digests()) == COUNT + 1
    with store.database.write() as connection:
        touch(connection, given_up)
    finish(server, recording)
    drop_old_recordings(store)
    assert server.client.get(f"/recordings/{recording}").json()["frames"] == COUNT
    with store.database.write() as connection:
        claimed = claim_build(connection)
        assert claimed is not None
        finish_build(connection, claimed.id, "succeeded", report={}, map_version=1)
        connection.exec_driver_sql(
            "UPDATE recordings SET active_at = ? WHERE id = ?",
            (str((now() - timedelta(days=4)).replace(tzinfo=None)), given_up),
        )
    drop_old_recordings(store)
    assert server.client.get(f"/recordings/{recording}").json()["frames"] == 0
    assert server.client.get(f"/recordings/{given_up}").status_code == 404
    with store.database.read() as connection:
        assert blob_uses(connection) == {}


def test_a_token_to_record_is_made_by_a_key_that_may_and_noted_when_it_ends_a_recording(
    server: Server,
) -> None:
    callers = Callers(server, "the-key-of-the-settings")
    visitor = callers.make("locate", VENUE)
    answer = server.client.post(
        "/tokens",
        json={"venue": VENUE, "scope": "record"},
        headers={"Authorization": f"Bearer {visitor.text}"},
    )
    assert_problem(answer, 403)
    token = server.client.post("/tokens", json={"venue": VENUE, "scope": "record"}).json()["token"]
    server.client.headers["Authorization"] = f"Bearer {token}"
    recording = begin(server)
    for number in range(COUNT):
        assert put(server, recording, number) == 200
    assert finish(server, recording)[0] == 202
    assert server.client.get(f"/venues/{VENUE}").status_code == 200
    assert server.client.get("/database/builds").status_code == 403
    server.client.headers["Authorization"] = "Bearer the-key-of-the-settings"
    acts = [(entry["act"], entry["venue"]) for entry in server.client.get("/audit").json()]
    assert ("POST /recordings/{recording}/finish", VENUE) in acts
    assert not any("frames" in act for act, _ in acts)
    assert OPEN.scope == "admin"
