"""What clients send in a form or a JSON body by mistake: a value twice, text as a file, JSON of which half is lost."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Iterator

import httpx
import pytest

from tests.api.test_request_bodies import JSON, multipart, post_form, venue_json
from tests.scenes import CAMERA_TEXT, View
from tests.server import Server, assert_problem, running

NUMBERS = [float(part) for part in CAMERA_TEXT.split(",")]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server with a venue and no map."""
    with running(tmp_path_factory.mktemp("values"), run_worker=False) as server:
        server.add_venue("v")
        yield server


def part(name: str, data: bytes, more: str = "", headers: str = "") -> bytes:
    head = f'--xyz\r\nContent-Disposition: form-data; name="{name}"{more}{headers}\r\n\r\n'
    return head.encode() + data + b"\r\n"


def post_parts(server: Server, *parts: bytes, kind: str = "multipart/form-data") -> httpx.Response:
    return post_form(server, "/locate", b"".join(parts) + b"--xyz--\r\n", kind)


def test_text_may_come_as_a_file(museum: Server, queries: list[View]) -> None:
    """As pages send a `Blob` of JSON, and curl a field with @."""
    camera = {"model": "PINHOLE", "width": 320, "height": 240, "params": NUMBERS[:4]}
    answer = post_parts(
        museum,
        part("image", queries[0].jpeg()),
        part("venue", b"museum", '; filename="venue.txt"'),
        part(
            "camera", json.dumps(camera).encode(), '; filename="blob"', "\r\nContent-Type: application/json"
        ),
    )
    assert answer.json().get("located"), answer.text


def test_a_camera_may_be_json_twice(museum: Server, queries: list[View]) -> None:
    assert museum.locate(queries[0].jpeg(), venue="museum", camera=json.dumps(CAMERA_TEXT))["located"]
    camera = {"model": "PINHOLE", "width": 320, "height": 240, "params": NUMBERS[:4]}
    twice = json.dumps(json.dumps(camera))
    assert museum.locate(queries[0].jpeg(), venue="museum", camera=twice)["located"]


@pytest.mark.parametrize(
    "packed",
    [
        lambda data: base64.encodebytes(data).decode(),
        lambda data: base64.urlsafe_b64encode(data).decode(),
        lambda data: base64.b64encode(data).decode().rstrip("="),
        lambda data: "data:image/jpeg;base64," + base64.b64encode(data).decode(),
    ],
    ids=["in lines", "for URLs", "without padding", "data URL"],
)
def test_every_base64_of_a_picture_is_read(museum: Server, queries: list[View], packed: object) -> None:
    assert callable(packed)
    # Of a length that needs padding, and with both characters that other alphabets have.
    picture = queries[0].jpeg() + b"\xfb\xff\xfe"
    picture += bytes(-len(picture) % 3 + 1)
    body = {"image": packed(picture), "venue": "museum", "camera": CAMERA_TEXT}
    assert museum.client.post("/locate", json=body).json().get("located")


def test_a_field_is_sent_once(site: Server) -> None:
    image, venue = part("image", b"x"), part("venue", b"v")
    with site.unchanged():
        twice = assert_problem(post_parts(site, image, image, venue), 422, "invalid_request")
        assert twice == "image: this form field was sent 2 times; send it once, and further ones as images"
        fields = assert_problem(post_parts(site, image, venue, venue, venue), 422, "invalid_request")
        assert fields == "venue: this form field was sent 3 times; send it once"
        route = site.client.get("/venues/v/route?from=a&from=b&to=c")
        assert "from: this query parameter was sent 2 times" in assert_problem(route, 422, "invalid_request")
        raw = site.client.post("/locate?venue=v&venue=w", content=b"x", headers={"Content-Type": "image/png"})
        assert "venue: this form field was sent 2 times" in assert_problem(raw, 422, "invalid_request")
        frames = post_form(site, "/anchors/none/frames", image + image + b"--xyz--\r\n")
        assert "image: this form field was sent 2 times" in assert_problem(frames, 422, "invalid_request")


def test_lists_are_sent_with_a_name_each(site: Server) -> None:
    image = part("image", b"x")
    answer = post_parts(site, image, part("images", b"x"), part("images", b"x"), part("venue", b"v"))
    assert "2 times" not in answer.text
    route = site.client.get("/venues/v/route?from=a&to=b&avoid=stairs&avoid=lift")
    assert_problem(route, 404, "not_found")


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        (
            (part("image", b"eA==", headers="\r\nContent-Transfer-Encoding: base64"),),
            "image: the part is encoded",
        ),
        ((part("image", b"x"), part("camera", b"1" * 1_100_000)), "camera: a text of a form has at most"),
        ((b"--abc\r\n", part("image", b"x")), "boundary that Content-Type names"),
        ((part("image", b"x").replace(b"\r\n", b"\n"),), "boundary that Content-Type names"),
    ],
    ids=["encoded", "long", "another boundary", "line feeds"],
)
def test_forms_that_can_not_be_read_say_why(site: Server, parts: tuple[bytes, ...], words: str) -> None:
    assert words in assert_problem(post_parts(site, *parts), 400, "bad_request")


def test_text_of_a_form_can_be_stored(site: Server) -> None:
    answer = post_parts(site, part("image", b"x"), part("venue", b"v\0"))
    assert "venue: the text holds a NUL" in assert_problem(answer, 422, "invalid_request")
    # A charset by which bytes become half a character.
    strange = post_parts(
        site,
        part("image", b"x"),
        part("venue", rb"\ud800"),
        kind="multipart/form-data; charset=unicode_escape",
    )
    assert "venue: the text holds half of a character" in assert_problem(strange, 422, "invalid_request")


@pytest.mark.parametrize("kind", ["", "text/plain", "multipart/mixed", "application/vnd.api+json"])
def test_a_body_of_another_media_type_is_named(site: Server, kind: str) -> None:
    headers = {"Content-Type": kind} if kind else {}
    with site.unchanged():
        picture = site.client.post("/locate", content=b"x", headers=headers)
        sentence = assert_problem(picture, 415, "unsupported_media_type")
        assert (kind or "without Content-Type") in sentence
        assert "-F image=@FILE" in sentence
        scan = site.client.post("/database/build", content=b"x", headers=headers)
        assert "-F archive=@FILE" in assert_problem(scan, 415, "unsupported_media_type")
        if kind != "application/vnd.api+json":
            venue = site.client.post("/venues", content=venue_json("w"), headers=headers)
            assert "Content-Type: application/json" in assert_problem(venue, 415, "unsupported_media_type")


def test_json_of_curl_without_its_media_type_and_features_in_a_form_are_named(site: Server) -> None:
    as_form = {"Content-Type": "application/x-www-form-urlencoded"}
    venue = site.client.post("/venues", content=venue_json("w"), headers=as_form)
    assert "Content-Type: application/json" in assert_problem(venue, 415, "unsupported_media_type")
    features = site.client.put("/venues/v/floors/0/features", files={"file": b"{}"})
    assert "--data-binary @FILE" in assert_problem(features, 415, "unsupported_media_type")


# A search for the one that stands twice that compares each key with all others would take minutes.
MANY_KEYS = b"{" + b"".join(b'"%d": 1, ' % number for number in range(70_000)) + b'"last": 1, "last": 2}'


@pytest.mark.parametrize("beginning", ["data:", " ", "data:;", ";base64"])
def test_long_text_in_place_of_a_picture_is_refused_without_a_search(site: Server, beginning: str) -> None:
    # A pattern that is tried from every character would take hours for it.
    text = beginning * (2_000_000 // len(beginning))
    answer = site.client.post("/locate", json={"image": text, "venue": "none"})
    assert answer.status_code in (404, 415, 422), answer.text[:200]


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_json_with_a_byte_order_mark_is_read(site: Server, encoding: str) -> None:
    body = json.dumps({"id": encoding, "name": "Küche"}).encode(encoding)
    answer = site.client.post("/venues", content=body, headers=JSON)
    assert answer.status_code == 201, answer.text
    assert answer.json()["name"] == "Küche"


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (b'{"id": "w" "name": "W"}', "not JSON: Expecting ',' delimiter: line 1 column 12"),
        (b"{'id': 'w'}", "not JSON: Expecting property name"),
        (b"[" * 100_000, "nested too deep"),
        ('{"id": "w", "name": "Küche"}'.encode("latin-1"), "not UTF-8"),
        (gzip.compress(venue_json("w")), "no Content-Encoding: gzip says so"),
        (b'{"id": "w", "id": "x", "name": "W"}', "id: this key stands twice"),
        (b'{"id": "w", "name": "W", "origin": {"latitude": 1, "latitude": 2}}', "latitude: this key stands twice"),
        (MANY_KEYS, "last: this key stands twice"),
        (b'{"id": "w", "name": "W\\u0000"}', "The body, name: the text holds a NUL character"),
        (b'{"id": "w", "name": "W \\ud83d"}', "half of a character"),
        (b'{"id": "w", "name": "W", "\\ud83d": 1}', "half of a character"),
        (b'{"id": "w", "name": "W", "x": ' + b"9" * 5000 + b"}", "too many digits"),
        (b'{"id": "w", "name": "  "}', "name: A name has at least one character"),
    ],
    ids=[
        "no comma", "single quotes", "nested", "Latin-1", "gzip", "twice", "twice inside", "many keys", "NUL",
        "surrogate", "surrogate in a key", "digits", "blank",
    ],
)  # fmt: skip
def test_json_that_can_not_be_meant_is_refused_with_the_reason(site: Server, body: bytes, words: str) -> None:
    with site.unchanged():
        answer = site.client.post("/venues", content=body, headers=JSON)
        assert words in assert_problem(answer, 422, "invalid_request")


@pytest.mark.parametrize("field", ["venue", "floor", "area", "camera", "axes", "method"])
def test_half_a_character_in_json_beside_a_picture_is_refused(site: Server, field: str) -> None:
    """It can't even be repeated in an answer."""
    body = f'{{"image": "eA==", "{field}": "\\ud800"}}'.encode()
    answer = site.client.post("/locate", content=body, headers=JSON)
    assert "half of a character" in assert_problem(answer, 422, "invalid_request")


def test_a_whole_form_of_texts_without_names_is_still_text(site: Server) -> None:
    answer = post_form(site, "/locate", multipart({"image": b"no picture", "venue": b"v"}))
    assert_problem(answer, 415, "unsupported_image")


@pytest.mark.parametrize("path", ["/venues", "/venues/v", "/venues/v/floors", "/openapi.json"])
def test_what_has_a_get_has_a_head(site: Server, path: str) -> None:
    got, head = site.client.get(path), site.client.head(path)
    assert (head.status_code, head.content) == (200, b"")
    assert head.headers["content-type"] == got.headers["content-type"]
    assert head.headers["content-length"] == got.headers["content-length"]


def test_a_head_of_what_is_not_there_or_has_no_get(site: Server) -> None:
    missing = site.client.head("/venues/none")
    assert (missing.status_code, missing.content) == (404, b"")
    posted = site.client.head("/locate")
    assert (posted.status_code, posted.headers["allow"]) == (405, "POST")


def test_a_head_of_events_ends_with_their_headers(site: Server) -> None:
    build = site.submit(b"no archive", "v").json()["build"]
    # Nothing works on the build, so that its events would go on.
    head = site.client.head(f"/database/builds/{build}/events")
    assert (head.status_code, head.content) == (200, b"")
    assert head.headers["content-type"].startswith("text/event-stream")
