"""A venue as a file: exported and imported unchanged, refused when anything in it is wrong, never half visible."""

from __future__ import annotations

import hashlib
import io
import json
import os
import signal
import subprocess
import sys
import tarfile
from collections.abc import Callable, Iterator
from datetime import timedelta
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from app.cli import app
from app.storage.blobs import BlobStore
from app.storage.db import Database
from app.storage.sweep import sweep_blobs
from tests.s3 import ABSENT, BUCKET, is_installed, s3
from tests.scenes import View
from tests.server import Server, assert_problem, running

ROOT = Path(__file__).parents[2]
Members = list[tuple[tarfile.TarInfo, bytes]]
FEATURES = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "id": "lobby",
            "geometry": {"type": "Point", "coordinates": [1.0, 2.0]},
            "properties": {"kind": "landmark", "name": "Lobby"},
        }
    ],
}
ANCHOR: dict[str, Any] = {
    "floor": "g",
    "position": {"x": 1, "y": 1},
    "height_m": 2,
    "camera": {"model": "PINHOLE", "width": 640, "height": 480, "params": [500, 500, 320, 240]},
    "pois": [
        {
            "id": "sign",
            "region_px": [[10, 10], [60, 10], [60, 60], [10, 60]],
            "position": {"x": 3, "y": 1},
            "distance_m": 2.5,
        }
    ],
}


@pytest.fixture(scope="module")
def exported(museum: Server) -> bytes:
    answer = museum.client.get("/venues/museum/export")
    assert answer.status_code == 200
    assert "content-encoding" not in answer.headers
    assert int(answer.headers["content-length"]) == len(answer.content)
    return answer.content


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server that the files are imported into; tests leave it without venues."""
    with running(tmp_path_factory.mktemp("imports"), run_worker=False) as server:
        yield server


def post(server: Server, data: bytes, **query: str) -> Any:
    return server.client.post("/venues/import", files={"archive": ("a.roomfix", data)}, params=query)


def unpacked(data: bytes) -> Members:
    with tarfile.open(fileobj=io.BytesIO(data), mode="r:") as archive:
        return [(info, archive.extractfile(info).read()) for info in archive]  # type: ignore[union-attr]


def packed(members: Members) -> bytes:
    """Return an archive, sizes as the contents are."""
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w:", format=tarfile.GNU_FORMAT) as archive:
        for info, content in members:
            info.size = len(content) if info.isreg() else 0
            archive.addfile(info, io.BytesIO(content))
    return out.getvalue()


def with_manifest(members: Members, change: Callable[[dict[str, Any]], object]) -> Members:
    """Return the members with a changed manifest and its right checksum."""
    values = json.loads(members[0][1])
    change(values)
    data = json.dumps(values).encode()
    digest = hashlib.sha256(data).hexdigest().encode()
    return [(members[0][0], data), (members[1][0], digest), *members[2:]]


def named(name: str, kind: bytes = tarfile.REGTYPE, link: str = "", size: int = 0) -> tarfile.TarInfo:
    info = tarfile.TarInfo(name)
    info.type, info.linkname, info.size = kind, link, size
    return info


def test_a_venue_keeps_its_place_on_earth(server: Server) -> None:
    client = server.client
    origin = {"latitude": 47.3782, "longitude": 8.5402, "height_m": 455.2, "heading_deg": 35.0, "floor": "g"}
    server.add_venue("a")
    client.put("/venues/a/floors/g", json={"name": "G", "level": 0, "z_min_m": 0, "z_max_m": 3})
    assert client.patch("/venues/a", json={"origin": origin}).status_code == 200
    data = client.get("/venues/a/export").content
    assert post(server, data, **{"as": "b"}).status_code == 201
    assert client.get("/venues/b").json()["origin"] == origin
    members = with_manifest(unpacked(data), lambda values: values["origin"].update(floor="none"))
    assert "floor in its origin" in assert_problem(post(server, packed(members), **{"as": "c"}), 422)
    # An origin whose floor is gone is of no use, and isn't exported.
    client.delete("/venues/a/floors/g")
    assert post(server, client.get("/venues/a/export").content, **{"as": "c"}).status_code == 201
    assert client.get("/venues/c").json()["origin"] is None
    for venue in "abc":
        assert client.delete(f"/venues/{venue}").status_code == 204


def test_a_map_moves_between_servers_and_answers_alike(
    server: Server, museum: Server, exported: bytes, queries: list[View]
) -> None:
    answer = post(server, exported)
    assert answer.status_code == 201, answer.text
    assert answer.json() == {
        "id": "museum", "name": "Museum", "map_version": 1, "floors": 0, "maps": 1, "cameras": {},
    }  # fmt: skip
    here, there = (
        each.client.get("/venues/museum/maps").json()[0]["statistics"] for each in (server, museum)
    )
    assert here == there
    image = queries[0].jpeg()
    first, second = (each.locate(image, venue="museum") for each in (museum, server))
    assert first["located"]
    assert first["pose"] == second["pose"]
    for row in ("0", "1"):
        path = f"/venues/museum/maps/1/keyframes/{row}/picture"
        assert server.client.get(path).content == museum.client.get(path).content
    again = server.client.get("/venues/museum/export").content
    assert unpacked(again)[0][1] == unpacked(exported)[0][1]
    assert server.client.delete("/venues/museum").status_code == 204


def test_floors_plans_features_and_cameras_come_along(server: Server) -> None:
    server.add_venue("hall")
    venue = "/venues/hall"
    floor = {
        "name": "Ground",
        "level": 0,
        "z_min_m": -0.5,
        "z_max_m": 3.0,
        "plan_from_world": np.eye(4).tolist(),
    }
    picture = cv2.imencode(".png", np.full((40, 60, 3), 255, np.uint8))[1].tobytes()
    for call in (
        lambda: server.client.put(f"{venue}/floors/g", json=floor),
        lambda: server.client.put(
            f"{venue}/floors/g/plan", data={"meters_per_pixel": "0.2"}, files={"image": picture}
        ),
        lambda: server.client.put(f"{venue}/floors/g/features", json=FEATURES),
        lambda: server.client.put("/anchors/door", json={**ANCHOR, "venue": "hall"}),
        lambda: server.client.post("/sessions", json={"venue": "hall"}),
    ):
        assert call().status_code < 300
    data = server.client.get(f"{venue}/export").content
    assert_problem(post(server, data), 409, "conflict")
    made = post(server, data, **{"as": "copy"})
    assert made.json()["cameras"] == {"door": "copy-door"}
    for path in ("floors", "floors/g/features"):
        before, after = (server.client.get(f"/venues/{name}/{path}").text for name in ("hall", "copy"))
        assert after == before.replace('"hall"', '"copy"')
    assert server.client.get("/venues/copy/floors/g/plan").content == picture
    before, after = (server.client.get(f"/anchors/{name}").json() for name in ("door", "copy-door"))
    assert after == {**before, "id": "copy-door", "venue": "copy"}
    # The copy of a copy would take a name that is taken.
    assert_problem(post(server, data, **{"as": "copy"}), 409, "conflict")
    assert server.client.delete("/venues/hall").status_code == 204
    with server.unchanged():
        assert_problem(post(server, data[:-4096]), 422, "invalid_input")
    assert post(server, data).json()["cameras"] == {"door": "door"}
    for name in ("copy", "hall"):
        assert server.client.delete(f"/venues/{name}").status_code == 204


def flipped(members: Members, position: int) -> Members:
    info, content = members[position]
    damaged = bytearray(content)
    damaged[len(damaged) // 2] ^= 1
    return [*members[:position], (info, bytes(damaged)), *members[position + 1 :]]


def renamed(members: Members, name: str) -> Members:
    return [*members[:-1], (named(name), members[-1][1])]


def swapped(values: dict[str, Any]) -> None:
    entry = values["maps"][0]
    entry["artifact_blob"], entry["index_blob"] = entry["index_blob"], entry["artifact_blob"]


def set_in_map(name: str, value: object) -> Callable[[dict[str, Any]], object]:
    return lambda values: values["maps"][0].update({name: value})


HOSTILE: dict[str, Callable[[Members], Members]] = {
    "a damaged map": lambda m: flipped(m, -1),
    "a damaged manifest": lambda m: flipped(m, 0),
    "a path outside": lambda m: renamed(m, "../../../../tmp/outside"),
    "an absolute path": lambda m: renamed(m, "/tmp/outside"),
    "a folder of blobs inside": lambda m: renamed(m, f"blobs/../{m[-1][0].name}"),
    "a link": lambda m: [*m[:2], (named(m[2][0].name, tarfile.SYMTYPE, "/etc/passwd"), b""), *m[2:]],
    "a hard link": lambda m: [*m[:2], (named("x", tarfile.LNKTYPE, "venue.json"), b""), *m[2:]],
    "a device": lambda m: [*m[:2], (named("x", tarfile.CHRTYPE), b""), *m[2:]],
    "a sparse file": lambda m: [*m[:2], (named(m[2][0].name, tarfile.GNUTYPE_SPARSE), b""), *m[2:]],
    "a long header": lambda m: [(named("x" * 300), b"x"), *m],
    "a further file": lambda m: [*m, (named("blobs/" + "0" * 64), b"x")],
    "a file twice": lambda m: [*m, m[-1]],
    "a file too few": lambda m: m[:-1],
    "no manifest": lambda m: m[2:],
    "no checksum": lambda m: [m[0], *m[2:]],
    "another version": lambda m: with_manifest(m, lambda v: v.update(version=2)),
    "another format": lambda m: with_manifest(m, lambda v: v.update(format="zip")),
    "an id that is a path": lambda m: with_manifest(m, lambda v: v.update(id="../museum")),
    "an unknown name": lambda m: with_manifest(m, lambda v: v.update(keys=[])),
    "not finite": lambda m: with_manifest(m, lambda v: v.update(active_map_version=float("nan"))),
    "another size": lambda m: with_manifest(m, lambda v: v["blobs"].update(dict.fromkeys(v["blobs"], 7))),
    "files swapped": lambda m: with_manifest(m, swapped),
    "pictures that are too few": lambda m: with_manifest(
        m, lambda v: v["maps"][0].update(images=v["maps"][0]["images"][:1])
    ),
    "statistics that can't be shown": lambda m: with_manifest(m, set_in_map("statistics", {"warnings": 7})),
    "an active map that isn't there": lambda m: with_manifest(m, lambda v: v.update(active_map_version=9)),
    "a huge version": lambda m: with_manifest(m, set_in_map("version", 10**30)),
    "a camera on no floor": lambda m: with_manifest(
        m,
        lambda v: v["anchors"].append(
            {
                "id": "x", "floor_id": "g", "x": 0, "y": 0, "height_m": 1, "heading_deg": None,
                "camera": [500, 500, 320, 240], "pois": [], "store_images": False, "max_age_s": None,
                "calibration": None,
            }
        ),
    ),
    "a plan_from_world that is none": lambda m: with_manifest(
        m,
        lambda v: v["floors"].append(
            {
                "id": "g", "name": "g", "level": 0, "z_min_m": 0, "z_max_m": 1, "plan_from_world": [[1.0]],
                "plan_residual_m": None, "plan": None, "features": None,
            }
        ),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_a_file_with_something_wrong_is_refused_and_leaves_nothing(
    server: Server, exported: bytes, name: str
) -> None:
    with server.unchanged():
        sentence = assert_problem(
            post(server, packed(HOSTILE[name](unpacked(exported)))), 422, "invalid_input"
        )
    assert len(sentence) < 300


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"no archive at all" * 100,
        bytes(1024),
        b"x" * 511,
        named("venue.json").tobuf(tarfile.GNU_FORMAT),
        # A header that promises more than follows, and more than memory holds.
        named("venue.json", size=2**40).tobuf(tarfile.GNU_FORMAT),
        packed([(named("venue.json"), b"[" * 100_000), (named("venue.json.sha256"), b"0" * 64)]),
    ],
)
def test_bytes_that_are_no_file_of_a_venue_are_refused(server: Server, data: bytes) -> None:
    with server.unchanged():
        assert assert_problem(post(server, data), 422)


def test_a_nested_manifest_is_refused(server: Server) -> None:
    data = b'{"format":"roomfix-venue","version":1,"id":' + b"[" * 200_000 + b"]" * 200_000 + b"}"
    digest = hashlib.sha256(data).hexdigest().encode()
    archive = packed([(named("venue.json"), data), (named("venue.json.sha256"), digest)])
    assert_problem(post(server, archive), 422, "invalid_input")


def test_a_process_that_is_killed_leaves_nothing_visible(tmp_path: Path, exported: bytes) -> None:
    file, data_dir = tmp_path / "museum.roomfix", tmp_path / "data"
    file.write_bytes(exported)
    code = (
        "import os, signal, sys\n"
        "from app.api.bodies.report import BuildReport\n"
        "from app.services.resources import Resources\n"
        "from app.services.venue_files.import_venue import import_venue\n"
        "from app.settings import Settings\n"
        "class Deadly:\n"
        "    def __init__(self, file, left): self.file, self.left = file, left\n"
        "    def read(self, size):\n"
        "        self.left -= size\n"
        "        if self.left < 0: os.kill(os.getpid(), signal.SIGKILL)\n"
        "        return self.file.read(size)\n"
        "resources = Resources.open(Settings(_env_file=None, data_dir=sys.argv[1]))\n"
        "with open(sys.argv[2], 'rb') as file:\n"
        "    import_venue(resources, Deadly(file, int(sys.argv[3])), BuildReport.model_validate)\n"
    )
    command = [sys.executable, "-c", code, str(data_dir), str(file), str(len(exported) * 3 // 4)]
    done = subprocess.run(command, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, check=False)
    assert done.returncode == -signal.SIGKILL
    database = Database(f"sqlite:///{data_dir / 'roomfix.db'}")
    blobs = BlobStore.open(None, data_dir, data_dir / "cache")
    assert blobs.digests()
    with database.read() as connection:
        assert not connection.exec_driver_sql("SELECT * FROM venues").all()
        assert not connection.exec_driver_sql("SELECT * FROM map_versions").all()
    sweep_blobs(database, blobs, timedelta(0))
    assert not blobs.digests()
    database.close()
    result = CliRunner().invoke(
        app, ["import-venue", str(file), "--data-dir", str(data_dir), "--as", "again"]
    )
    assert result.exit_code == 0, result.output
    written = tmp_path / "again.roomfix"
    export = ["export-venue", "again", str(written), "--data-dir", str(data_dir), "--active"]
    result = CliRunner().invoke(app, export)
    assert result.exit_code == 0, result.output
    assert [info.name for info, _ in unpacked(written.read_bytes())] == [
        info.name for info, _ in unpacked(exported)
    ]


@pytest.mark.skipif(not is_installed(), reason=ABSENT)
def test_a_map_is_served_from_an_object_store(
    tmp_path: Path, exported: bytes, queries: list[View], monkeypatch: pytest.MonkeyPatch
) -> None:
    with s3(tmp_path) as variables:
        for name, value in variables.items():
            monkeypatch.setenv(name, value)
        for data in ("one", "two"):
            # The second server has the first one's database, and no copy of any blob.
            database = f"sqlite:///{tmp_path / 'shared.db'}"
            there = {"database_url": database, "blob_url": f"s3://{BUCKET}/maps"}
            with running(tmp_path / data, run_worker=False, **there) as server:
                assert data == "two" or post(server, exported).status_code == 201
                assert server.locate(queries[0].jpeg(), venue="museum")["located"]
                assert not (tmp_path / data / "blobs").exists()
                again = server.client.get("/venues/museum/export").content
        assert [content for _, content in unpacked(again)] == [content for _, content in unpacked(exported)]


def test_exports_and_imports_are_in_the_audit_log(tmp_path: Path) -> None:
    with running(tmp_path, run_worker=False, admin_key="the-key") as server:
        server.client.headers["Authorization"] = "Bearer the-key"
        server.add_venue("hall")
        data = server.client.get("/venues/hall/export").content
        assert post(server, data, **{"as": "copy"}).status_code == 201
        entries = server.client.get("/audit").json()
        acts = [(entry["act"], entry["venue"]) for entry in entries]
        assert acts[:2] == [("POST /venues/import", "copy"), ("GET /venues/{venue}/export", "hall")]
