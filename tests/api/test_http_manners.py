"""What HTTP clients may rely on: ETags, compression, pages, methods, other origins, and other forms of a picture."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from app.settings import Settings
from tests.scenes import CAMERA_TEXT, View, encode, scan_files, zipped
from tests.server import QUICK, Server, assert_problem, running

FLOOR = {"name": "Ground", "level": 0, "z_min_m": -1, "z_max_m": 3}
FEATURES = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [k / 10, 0]},
            "properties": {"kind": "landmark", "id": f"l{k}", "name": f"Landmark {k}"},
        }
        for k in range(50)
    ],
}


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server with a venue, a floor, its plan and features; pages of one other origin may call."""
    folder = tmp_path_factory.mktemp("site")
    with running(folder, run_worker=False, cors_origins="https://app.example, https://b.example") as server:
        server.add_venue("site")
        assert server.client.put("/venues/site/floors/0", json=FLOOR).status_code == 200
        assert server.client.put("/venues/site/floors/0/features", json=FEATURES).status_code == 200
        answer = server.client.put(
            "/venues/site/floors/0/plan",
            data={"meters_per_pixel": "0.1", "origin_px": "0,10"},
            files={"image": encode(np.zeros((60, 80, 3), np.uint8), ".png")},
        )
        assert answer.status_code == 200, answer.text
        yield server


@pytest.mark.parametrize(
    "text",
    ["https://app.example/", '["https://app.example"]', "app.example", "https://a.example https://b.example"],
)
def test_origins_that_no_page_has_are_refused_when_the_server_starts(text: str) -> None:
    with pytest.raises(ValidationError, match="is no origin: write scheme://host"):
        Settings(_env_file=None, cors_origins=text)
    found = Settings(
        _env_file=None, cors_origins="capacitor://localhost, http://[::1]:8000,*"
    ).allowed_origins
    assert found == ("capacitor://localhost", "http://[::1]:8000", "*")


@pytest.mark.parametrize("path", ["plan", "features"])
def test_what_a_client_has_is_not_sent_again(site: Server, path: str) -> None:
    where = f"/venues/site/floors/0/{path}"
    first = site.client.get(where)
    tag = first.headers["etag"]
    again = site.client.get(where, headers={"If-None-Match": f'"other", {tag}'})
    assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", tag)
    assert site.client.get(where, headers={"If-None-Match": '"other"'}).status_code == 200
    # A shared cache must not give it to somebody without a key.
    assert "private" in first.headers["cache-control"]


def test_features_that_change_have_another_tag(site: Server) -> None:
    where = "/venues/site/floors/0/features"
    before = site.client.get(where).headers["etag"]
    changed = site.client.put(where, json={**FEATURES, "features": FEATURES["features"][:40]})
    assert changed.status_code == 200, changed.text
    assert site.client.get(where).headers["etag"] != before
    site.client.put(where, json=FEATURES)
    assert site.client.get(where).headers["etag"] == before


def test_json_is_compressed_and_pictures_are_not(site: Server) -> None:
    with site.client.stream(
        "GET", "/venues/site/floors/0/features", headers={"Accept-Encoding": "gzip"}
    ) as answer:
        packed = b"".join(answer.iter_raw())
    assert answer.headers["content-encoding"] == "gzip"
    assert json.loads(gzip.decompress(packed))["features"][0]["properties"]["name"] == "Landmark 0"
    plain = site.client.get("/venues/site/floors/0/features", headers={"Accept-Encoding": "identity"})
    assert "content-encoding" not in plain.headers
    assert len(packed) < len(plain.content) / 3
    assert "content-encoding" not in site.client.get("/venues/site/floors/0/plan").headers


def test_a_list_comes_in_pages(empty: Server) -> None:
    names = [f"venue-{k}" for k in range(7)]
    for name in names:
        empty.add_venue(name)
    assert [venue["id"] for venue in empty.client.get("/venues").json()] == names
    found, address, pages = [], "/venues?limit=3", 0
    while address:
        answer = empty.client.get(address)
        found += [venue["id"] for venue in answer.json()]
        address, pages = answer.links.get("next", {}).get("url", ""), pages + 1
    assert (found, pages) == (names, 3)
    assert "cursor" in assert_problem(empty.client.get("/venues?cursor=nothing"), 422)
    for wrong in ("0", "1001", "x"):
        assert_problem(empty.client.get(f"/venues?limit={wrong}"), 422, "invalid_request")


@pytest.mark.parametrize(
    ("path", "allowed"),
    [
        ("/venues", "GET, HEAD, POST"),
        ("/venues/site", "DELETE, GET, HEAD, PATCH"),
        ("/healthz", "GET, HEAD"),
        ("/locate", "POST"),
    ],
)
def test_a_method_that_a_path_lacks_is_answered_with_those_it_has(
    site: Server, path: str, allowed: str
) -> None:
    answer = site.client.put(path)
    assert_problem(answer, 405, "method_not_allowed")
    assert answer.headers["allow"] == allowed


def test_health_has_a_head(site: Server) -> None:
    answer = site.client.head("/healthz")
    assert (answer.status_code, answer.content) == (200, b"")


def test_pages_of_origins_that_are_set_may_call(site: Server) -> None:
    asked = {"Origin": "https://app.example", "Access-Control-Request-Method": "POST",
             "Access-Control-Request-Headers": "authorization,content-type"}  # fmt: skip
    preflight = site.client.options("/locate", headers=asked)
    assert preflight.status_code == 200
    assert preflight.headers["access-control-allow-origin"] == "https://app.example"
    answer = site.client.get("/venues", headers={"Origin": "https://b.example"})
    assert answer.headers["access-control-allow-origin"] == "https://b.example"
    assert "X-Request-ID" in answer.headers["access-control-expose-headers"]
    # An error can be read too.
    missing = site.client.get("/venues/none", headers={"Origin": "https://app.example"})
    assert (missing.status_code, missing.headers["access-control-allow-origin"]) == (
        404,
        "https://app.example",
    )
    other = site.client.get("/venues", headers={"Origin": "https://evil.example"})
    assert other.status_code == 403
    assert "access-control-allow-origin" not in other.headers


def comparable(result: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in result.items() if name != "timings_ms"}


def test_a_picture_may_be_the_body_or_base64_in_json(museum: Server, queries: list[View]) -> None:
    picture = queries[0].jpeg()
    form = museum.locate(picture, venue="museum")
    assert form["located"]
    fields = {"camera": CAMERA_TEXT, "venue": "museum"}
    for kind in ("image/jpeg", "Image/PNG", "application/octet-stream"):
        raw = museum.client.post("/locate", params=fields, content=picture, headers={"Content-Type": kind})
        assert comparable(raw.json()) == comparable(form)
    packed = {"image": base64.b64encode(picture).decode(), "venue": "museum", "floor": None}
    camera = [float(part) for part in CAMERA_TEXT.split(",")]
    x, y, z = form["pose"]["position"].values()
    prior = {"position": {"x": x, "y": y, "z": z}, "radius_m": 2}
    as_json = museum.client.post("/locate", json={**packed, "camera": camera, "prior": prior}).json()
    assert as_json["located"]
    assert as_json["narrowed"]
    session = museum.client.post("/sessions", json={"venue": "museum", "camera": camera}).json()["session"]
    tracked = museum.client.post(
        f"/sessions/{session}/frames", json={"image": packed["image"], "timestamp": 1.5}
    )
    assert tracked.json()["tracking"] == "tracking"


@pytest.mark.parametrize(
    ("body", "word"),
    [
        (b"{", "JSON"), (b"[]", "object"), (b'{"image": "%%%"}', "base64"), (b'{"image": 5}', "base64"),
        (b'{"venue": "site"}', "image"), (b'{"image": "aGk=", "venu": "site"}', "did you mean venue"),
        (b'{"image": "aGk=", "prior": {"radius": 1}}', "prior.radius"), (b"[" * 100_000, "JSON"),
    ],
)  # fmt: skip
def test_json_that_holds_no_picture_is_refused(site: Server, body: bytes, word: str) -> None:
    answer = site.client.post("/locate", content=body, headers={"Content-Type": "application/json"})
    assert word in assert_problem(answer, 422)


def test_fields_of_a_picture_that_is_the_body_are_checked(site: Server) -> None:
    answer = site.client.post("/locate?venu=site", content=b"x", headers={"Content-Type": "image/jpeg"})
    assert "did you mean venue" in assert_problem(answer, 422, "invalid_request")


def test_the_same_submission_is_the_same_build(site: Server, scan_zip: bytes) -> None:
    def submit(key: str, archive: bytes = scan_zip, options: str = '{"force": false}') -> Any:
        return site.client.post(
            "/database/build",
            data={"venue": "site", "options": options},
            files={"archive": archive},
            headers={"Idempotency-Key": key},
        )

    first = submit("upload-1")
    assert first.status_code == 202
    assert submit("upload-1").json() == first.json()
    assert submit("upload-2").json() != first.json()
    assert first.json()["build"] in assert_problem(submit("upload-1", scan_zip + b"x"), 409, "conflict")
    assert_problem(submit("upload-1", options='{"force": true}'), 409, "conflict")
    assert len(site.client.get("/database/builds?venue=site").json()) == 2


def test_a_map_version_that_does_not_serve_can_be_deleted(tmp_path: Path, views: list[View]) -> None:
    with running(tmp_path, run_worker=False) as server:
        server.add_venue("v")
        scan = zipped(scan_files(views[:4]))
        assert server.add_maps("v", (scan, QUICK), (scan, QUICK))["map_version"] == 2
        assert "serves" in assert_problem(server.client.delete("/venues/v/maps/2"), 409, "conflict")
        assert server.client.delete("/venues/v/maps/1").status_code == 204
        assert [entry["version"] for entry in server.client.get("/venues/v/maps").json()] == [2]
        assert_problem(server.client.delete("/venues/v/maps/1"), 404, "not_found")
        # What the other version needs is still there.
        assert server.client.post("/venues/v/maps/2/activate").status_code == 200
