"""Uploads by the tus protocol: they go on where they broke, are refused before they travel, and become builds."""

from __future__ import annotations

import base64
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.commands.uploads.client import begin_upload, send_file, upload_file
from app.errors import InvalidInputError, NotFoundError, RoomfixError, StorageFullError, UploadLockedError
from app.storage import uploads as upload_store
from app.storage.uploads import UploadFolder
from bench.uploads.cutting_proxy import cutting_proxy
from tests.scenes import CAMERA_TEXT, View, scan_files, zipped
from tests.server import Server, assert_problem, listening, running

TUS = {"Tus-Resumable": "1.0.0"}
PART = {**TUS, "Content-Type": "application/offset+octet-stream"}
MAX_BYTES = 5_000_000


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    with running(tmp_path_factory.mktemp("uploads"), run_worker=False, max_archive_bytes=MAX_BYTES) as server:
        server.add_venue("museum")
        yield server


def begin(server: Server, length: int, **headers: str) -> httpx.Response:
    return server.client.post("/uploads", headers={**TUS, "Upload-Length": str(length), **headers})


def begun(server: Server, length: int) -> str:
    answer = begin(server, length)
    assert answer.status_code == 201, answer.text
    assert answer.headers["tus-resumable"] == "1.0.0"
    return str(answer.headers["location"])


def append(server: Server, url: str, offset: int, data: bytes, **headers: str) -> httpx.Response:
    return server.client.patch(url, content=data, headers={**PART, "Upload-Offset": str(offset), **headers})


def offset_of(server: Server, url: str) -> int:
    answer = server.client.head(url, headers=TUS)
    assert answer.status_code == 200
    assert answer.headers["cache-control"] == "no-store"
    return int(answer.headers["upload-offset"])


def build(server: Server, url: str, **headers: str) -> httpx.Response:
    form = {
        "venue": "museum",
        "options": f'{{"camera": "{CAMERA_TEXT}"}}',
        "upload": url.rsplit("/", maxsplit=1)[-1],
    }
    return server.client.post("/database/build", data=form, headers=headers)


def test_parts_become_a_build_of_the_whole_and_the_upload_is_gone(server: Server, views: list[View]) -> None:
    scan = zipped(scan_files(views[:4]))
    url = begun(server, len(scan))
    for start in range(0, len(scan), 100_000):
        assert offset_of(server, url) == start
        answer = append(server, url, start, scan[start : start + 100_000])
        assert answer.status_code == 204
    assert int(answer.headers["upload-offset"]) == len(scan)
    first = build(server, url, **{"Idempotency-Key": "one"})
    assert first.status_code == 202, first.text
    as_form = server.submit(scan, "museum").json()["build"]
    rows = [row for row in server.rows()["builds"] if first.json()["build"] in row or as_form in row]
    digest = {name.rsplit("/", 1)[-1] for name in server.files() if name.startswith("blobs/")}
    assert len(rows) == 2
    assert all(any(each in row for each in digest) for row in rows)
    assert server.client.head(url, headers=TUS).status_code == 404
    # The answer was lost, and the client asks again.
    assert build(server, url, **{"Idempotency-Key": "one"}).json() == first.json()
    assert_problem(build(server, url), 404, "not_found")


def test_what_a_client_gets_wrong_is_refused_and_nothing_is_stored(server: Server) -> None:
    url = begun(server, 10)
    assert_problem(append(server, url, 4, b"x"), 409, "conflict")
    assert_problem(append(server, url, 0, b"x" * 11), 422, "invalid_input")
    assert_problem(
        append(server, url, 0, b"x", **{"Content-Type": "text/plain"}), 415, "unsupported_media_type"
    )
    other = server.client.patch(
        url, content=b"x", headers={**PART, "Tus-Resumable": "0.2", "Upload-Offset": "0"}
    )
    assert_problem(other, 412, "unknown_protocol")
    assert other.headers["tus-version"] == "1.0.0"
    assert offset_of(server, url) == 0
    assert_problem(build(server, url), 409, "conflict")
    both = server.client.post(
        "/database/build", data={"venue": "museum", "upload": "x"}, files={"archive": b"x"}
    )
    assert_problem(both, 422, "invalid_request")
    assert_problem(begin(server, 10, **{"Upload-Metadata": "venue !"}), 422, "invalid_input")
    for path in ("0" * 32, "..%2Froomfix.db", "x"):
        assert_problem(append(server, f"/uploads/{path}", 0, b"x"), 404, "not_found")
    assert server.client.delete(url, headers=TUS).status_code == 204
    assert server.client.head(url, headers=TUS).status_code == 404


@pytest.mark.parametrize(
    ("path", "fields"), [("/database/inspect", {}), ("/database/calibrate", {"venue": "museum"})]
)
def test_an_upload_that_is_not_whole_or_no_scan_is_refused_and_stays(
    server: Server, path: str, fields: dict[str, str]
) -> None:
    def post(upload: str, **more: Any) -> httpx.Response:
        return server.client.post(path, data={**fields, "upload": upload}, **more)

    url = begun(server, 3)
    upload = url.rsplit("/", 1)[-1]
    assert "of 3 bytes" in assert_problem(post(upload), 409, "conflict")
    append(server, url, 0, b"abc")
    assert_problem(post(upload), 422, "invalid_scan")
    # It is still there, for whatever the client wants of it next.
    assert offset_of(server, url) == 3
    assert_problem(post(upload, files={"archive": b"abc"}), 422, "invalid_request")
    assert "upload" in assert_problem(server.client.post(path, data=fields), 422, "invalid_request")
    for unknown in ("0" * 32, "../roomfix.db"):
        assert_problem(post(unknown), 404, "not_found")
    assert server.client.delete(url, headers=TUS).status_code == 204


def test_what_can_not_fit_is_refused_before_it_travels(
    server: Server, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    assert_problem(begin(server, MAX_BYTES + 1), 413, "upload_too_large")
    folder = UploadFolder(tmp_path, 10**12)
    free = 3_000_000_000
    usage: Any = shutil._ntuple_diskusage(10**12, 0, free)  # type: ignore[attr-defined]
    monkeypatch.setattr(upload_store.shutil, "disk_usage", lambda _: usage)
    # Until it is stored there are two of it.
    room = (free - upload_store.OPTIONS.spare_bytes) // 2
    with pytest.raises(StorageFullError, match="free"):
        folder.create(room + 1, None)
    folder.create(room - 1000, None)
    # What has been promised to the first is not free for the second.
    with pytest.raises(StorageFullError):
        folder.create(1001, None)
    folder.create(1000, None)


def test_one_part_is_written_at_a_time_and_an_old_upload_is_swept(tmp_path: Path) -> None:
    folder = UploadFolder(tmp_path, 1000)
    upload = folder.create(10, None)
    with folder.appending(upload.id, 0) as part:
        part.write(b"abc")
        with pytest.raises(UploadLockedError), folder.appending(upload.id, 0):
            pass
        with pytest.raises(UploadLockedError):
            folder.delete(upload.id)
    # Another process sees what is on the disk.
    assert UploadFolder(tmp_path, 1000).get(upload.id).offset == 3
    old_s = upload.path.stat().st_mtime - 3600 * upload_store.OPTIONS.keep_h - 1
    os.utime(upload.path, (old_s, old_s))
    kept = folder.create(10, None)
    assert sorted(path.stem for path in tmp_path.iterdir()) == [kept.id, kept.id]


def test_an_upload_belongs_to_its_venue(tmp_path: Path) -> None:
    admin = {"Authorization": "Bearer the-key-of-the-settings"}
    with running(tmp_path, run_worker=False, admin_key="the-key-of-the-settings") as server:
        for venue in ("museum", "hotel"):
            server.client.post("/venues", json={"id": venue, "name": venue}, headers=admin)
        keys = {
            venue: {
                "Authorization": "Bearer "
                + server.client.post(
                    "/keys", json={"name": venue, "scope": "admin", "venue": venue}, headers=admin
                ).json()["text"]
            }
            for venue in ("museum", "hotel")
        }
        assert_problem(begin(server, 10), 401)
        url = begin(server, 3, **keys["museum"]).headers["location"]
        assert append(server, url, 0, b"abc", **keys["museum"]).status_code == 204
        assert server.client.head(url, headers={**TUS, **keys["hotel"]}).status_code == 403
        for path, venue in (("build", "hotel"), ("calibrate", "hotel"), ("inspect", None)):
            form = {"venue": venue, "upload": url.split("/")[-1]} if venue else {"upload": url.split("/")[-1]}
            answer = server.client.post(f"/database/{path}", data=form, headers=keys["hotel"])
            assert "another venue" in assert_problem(answer, 403, "forbidden")
        metadata = {"Upload-Metadata": f"venue {base64.b64encode(b'hotel').decode()}"}
        assert_problem(begin(server, 3, **keys["museum"], **metadata), 403)
        # Parts are not acts.
        acts = [entry["act"] for entry in server.client.get("/audit", headers=admin).json()]
        assert not any("/uploads" in act for act in acts)


def test_a_file_arrives_whole_over_a_connection_that_breaks(tmp_path: Path) -> None:
    """By the client of `roomfix upload`; `roomfix upload-bench` does it with 2 GB, and measures memory and disk."""
    file, pauses = tmp_path / "scan.zip", []
    file.write_bytes(os.urandom(4_000_000))
    with listening(tmp_path / "data") as (url, _), cutting_proxy(url, 4_000_000, 6) as proxy:
        with httpx.Client(base_url=proxy.url) as client:
            upload = begin_upload(client, 4_000_000, "museum")
            sent = send_file(client, upload, file, pause=pauses.append)
            # A cut that meets the answer of a request that came too early breaks nothing that the client sees.
            assert proxy.cuts == 6
            assert sent.breaks > 0
            assert len(pauses) >= 6
            short = tmp_path / "other.zip"
            short.write_bytes(b"x")
            with pytest.raises(InvalidInputError, match="4000000"):
                send_file(client, upload, short)
            with pytest.raises(RoomfixError, match="accepted"):
                begin_upload(client, 10**13, "museum")
        assert (
            tmp_path / "data" / "uploads" / f"{upload.split('/')[-1]}.part"
        ).read_bytes() == file.read_bytes()


def test_an_upload_that_is_lost_with_its_server_is_begun_anew(tmp_path: Path) -> None:
    file, urls = tmp_path / "scan.zip", []
    file.write_bytes(os.urandom(100_000))
    with listening(tmp_path / "data") as (address, _), httpx.Client(base_url=address) as client:

        def lose_first(url: str) -> None:
            urls.append(url)
            if len(urls) == 1:
                client.delete(url, headers=TUS).raise_for_status()

        sent = upload_file(client, file, "museum", None, lose_first)
        assert urls[1:] == [sent.url]
        assert client.head(sent.url, headers=TUS).headers["upload-offset"] == "100000"
        # One that was named is not sent twice unasked.
        with pytest.raises(NotFoundError):
            upload_file(client, file, "museum", urls[0], lambda _: None)
