"""Bodies as clients send them: gzip, media types in any case, file parts without a file name."""

from __future__ import annotations

import gzip
import json
import zlib
from collections.abc import Iterator
from typing import Any

import httpx
import pytest

from tests.scenes import CAMERA_TEXT, View
from tests.server import Server, assert_problem, running

LIMIT_BYTES = 50_000
# A body may have this much beside its file.
OVERHEAD_BYTES = 1_000_000
JSON = {"Content-Type": "application/json"}


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server that takes small uploads only."""
    limits = {"max_image_bytes": LIMIT_BYTES, "max_archive_bytes": LIMIT_BYTES}
    with running(tmp_path_factory.mktemp("small"), run_worker=False, **limits) as server:
        yield server


def post_venue(server: Server, content: Any, encoding: str) -> httpx.Response:
    headers = {**JSON, "Content-Encoding": encoding}
    return server.client.post("/venues", content=content, headers=headers)


def venue_json(name: str) -> bytes:
    return json.dumps({"id": name, "name": name}).encode()


def multipart(fields: dict[str, bytes]) -> bytes:
    """Return a form whose parts have names and nothing else."""
    parts = (
        b'--xyz\r\nContent-Disposition: form-data; name="%s"\r\n\r\n%s\r\n' % (name.encode(), value)
        for name, value in fields.items()
    )
    return b"".join(parts) + b"--xyz--\r\n"


def post_form(
    server: Server, path: str, body: bytes, kind: str = "multipart/form-data", **headers: str
) -> httpx.Response:
    return server.client.post(
        path, content=body, headers={"Content-Type": f"{kind}; boundary=xyz", **headers}
    )


@pytest.mark.parametrize("encoding", ["gzip", "GZIP", "x-gzip", "identity", "identity, gzip", ""])
def test_encodings_that_are_read(small: Server, encoding: str) -> None:
    name = f"v-{encoding.replace(', ', '-').lower()}x{encoding.isupper()}"
    body = venue_json(name)
    answer = post_venue(small, gzip.compress(body) if "gzip" in encoding.lower() else body, encoding)
    assert answer.status_code == 201, answer.text
    assert answer.json()["id"] == name


def test_gzip_in_small_pieces_and_in_several_members(small: Server) -> None:
    body = venue_json("pieces")
    members = gzip.compress(body[:9]) + gzip.compress(b"") + gzip.compress(body[9:])
    answer = post_venue(small, iter([members[i : i + 3] for i in range(0, len(members), 3)]), "gzip")
    assert answer.status_code == 201, answer.text


@pytest.mark.parametrize(
    "encoding", ["br", "zstd", "deflate", "compress", "gzip, gzip", "br, gzip", "x" * 5000]
)
def test_encodings_that_are_not_read(small: Server, encoding: str) -> None:
    with small.unchanged():
        answer = post_venue(small, venue_json("never"), encoding)
        assert "gzip" in assert_problem(answer, 415, "unsupported_encoding")
        assert "gzip" in answer.headers["accept-encoding"]


@pytest.mark.parametrize(
    "content",
    [
        venue_json("never"),
        zlib.compress(venue_json("never")),
        gzip.compress(venue_json("never"))[:-1],
        gzip.compress(venue_json("never"))[:12],
        gzip.compress(venue_json("never")) + b"more",
        gzip.compress(venue_json("never"))[:-8] + bytes(8),
    ],
    ids=["plain", "zlib", "cut", "head", "trailer", "checksum"],
)
def test_gzip_that_is_broken(small: Server, content: bytes) -> None:
    with small.unchanged():
        answer = post_venue(small, content, "gzip")
        assert "gzip" in assert_problem(answer, 422, "invalid_input")


def test_no_body_needs_no_gzip(small: Server) -> None:
    assert small.client.get("/venues", headers={"Content-Encoding": "gzip"}).status_code == 200


@pytest.mark.parametrize("path", ["/venues", "/locate", "/database/build"])
def test_a_gzip_bomb_is_refused(small: Server, path: str) -> None:
    head = b'--xyz\r\nContent-Disposition: form-data; name="image"; filename="x"\r\n\r\n'
    bomb = gzip.compress((b"" if path == "/venues" else head) + bytes(100_000_000))
    assert len(bomb) < OVERHEAD_BYTES + LIMIT_BYTES < 100_000_000
    kind = "application/json" if path == "/venues" else "multipart/form-data; boundary=xyz"
    with small.unchanged():
        answer = small.client.post(
            path, content=bomb, headers={"Content-Type": kind, "Content-Encoding": "gzip"}
        )
        assert "larger than" in assert_problem(answer, 413, "upload_too_large")


def test_many_empty_members_are_no_endless_work(small: Server) -> None:
    members = gzip.compress(b"") * 50_000
    answer = post_venue(small, members, "gzip")
    assert_problem(answer, 422)
    assert_problem(post_venue(small, members + members, "gzip"), 413, "upload_too_large")


def test_the_compressed_length_is_limited_too(small: Server) -> None:
    answer = post_venue(small, bytes(OVERHEAD_BYTES + LIMIT_BYTES + 1), "gzip")
    assert_problem(answer, 413, "upload_too_large")


def test_a_photo_in_a_gzip_form_is_located(museum: Server, queries: list[View]) -> None:
    form = {"image": queries[0].jpeg(), "venue": b"museum", "camera": CAMERA_TEXT.encode()}
    plain = post_form(museum, "/locate", multipart(form))
    packed = post_form(museum, "/locate", gzip.compress(multipart(form)), **{"Content-Encoding": "gzip"})
    assert packed.status_code == 200, packed.text
    assert packed.json()["located"]
    assert packed.json()["pose"] == plain.json()["pose"]


def test_a_part_without_a_file_name_is_the_file(museum: Server, queries: list[View]) -> None:
    """Larger than what a form field may have, and no text in any encoding."""
    # Bytes behind the end of a JPEG are ignored.
    photo = queries[0].jpeg() + bytes(range(256)) * 8000
    form = {"image": photo, "venue": b"museum", "camera": CAMERA_TEXT.encode()}
    nameless = post_form(museum, "/locate", multipart(form))
    assert nameless.status_code == 200, nameless.text
    named = museum.post_image(photo, {"venue": "museum", "camera": CAMERA_TEXT})
    assert nameless.json()["located"]
    assert nameless.json()["pose"] == named.json()["pose"]


def test_a_scan_and_a_plan_without_file_names(museum: Server, scan_zip: bytes) -> None:
    archive = {"archive": scan_zip, "venue": b"nowhere"}
    assert_problem(post_form(museum, "/database/build", multipart(archive)), 404, "not_found")
    plan = {"image": b"no picture", "meters_per_pixel": b"1", "origin_px": b"0,0"}
    answer = museum.client.put(
        "/venues/nowhere/floors/0/plan",
        content=multipart(plan),
        headers={"Content-Type": "multipart/form-data; boundary=xyz"},
    )
    assert_problem(answer, 404, "not_found")


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"--xyz",
        b"--xyz\r\n\r\n\r\n--xyz--",
        b"--xyz\r\nContent-Disposition: form-data\r\n\r\nx\r\n--xyz--\r\n",
        b'--xyz\r\nContent-Disposition: form-data; name="image\r\n\r\nx\r\n--xyz--\r\n',
        b'--xyz\r\nContent-Disposition: form-data; name="\xff\xfe"\r\n\r\nx\r\n--xyz--\r\n',
    ],
    ids=["empty", "cut", "no headers", "no name", "open quote", "bytes as name"],
)
def test_forms_that_are_broken(small: Server, body: bytes) -> None:
    with small.unchanged():
        answer = post_form(small, "/locate", body)
        assert answer.status_code in (400, 422)
        assert_problem(answer, answer.status_code)


def test_a_form_without_a_boundary(small: Server) -> None:
    answer = small.client.post("/locate", content=b"x", headers={"Content-Type": "multipart/form-data"})
    assert_problem(answer, 400, "bad_request")


@pytest.mark.parametrize("kind", ["multipart/form-data", "Multipart/Form-Data", "MULTIPART/FORM-DATA "])
def test_media_types_of_forms_in_any_case(museum: Server, queries: list[View], kind: str) -> None:
    form = {"image": queries[0].jpeg(), "venue": b"museum", "camera": CAMERA_TEXT.encode()}
    answer = post_form(museum, "/locate", multipart(form), kind)
    assert answer.json().get("located"), answer.text


def test_media_types_of_json_in_any_case(small: Server) -> None:
    headers = {"Content-Type": "Application/JSON; Charset=UTF-8"}
    answer = small.client.post("/venues", content=venue_json("capitals"), headers=headers)
    assert answer.status_code == 201, answer.text
