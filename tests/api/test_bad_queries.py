"""Hostile and mistaken /locate requests: a clear 4xx each, and nothing changed on disk."""

from __future__ import annotations

import json
import struct
import zlib
from typing import Any

import numpy as np
import pytest

from tests.scenes import CAMERA_TEXT, View, encode
from tests.server import Server, assert_problem


def png_of_size(width: int, height: int) -> bytes:
    """Return a small PNG file that claims to be huge."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    rows = zlib.compress(b"\0" * 1_000_000)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


GRAY = np.full((240, 320), 128, np.uint8)
NOT_IMAGES = {
    "empty": (b"", 422, "invalid_image"),
    "text": (b"this is not an image, whatever its name says. " * 20, 415, "unsupported_image"),
    "gif": (b"GIF89a" + bytes(100), 415, "unsupported_image"),
    "svg": (b"<svg xmlns='http://www.w3.org/2000/svg'><script>1</script></svg>", 415, "unsupported_image"),
    "jpeg without a picture": (b"\xff\xd8\xff\xe0\x00\x10JFIF\x00", 422, "invalid_image"),
    "40,000 x 40,000": (png_of_size(40_000, 40_000), 413, "image_too_large"),
    "over the limit": (png_of_size(8000, 8000), 413, "image_too_large"),
    "png cut short": (encode(GRAY, ".png")[:60], 422, "invalid_image"),
    "too small": (encode(GRAY[:20, :20], ".png"), 422, "invalid_image"),
    "a strip": (encode(np.zeros((32, 2000), np.uint8), ".png"), 422, "invalid_image"),
    "no pixels": (png_of_size(0, 0), 422, None),
}


@pytest.mark.parametrize("name", NOT_IMAGES)
def test_what_is_no_image_is_refused(museum: Server, name: str) -> None:
    data, status, code = NOT_IMAGES[name]
    with museum.unchanged():
        answer = museum.post_image(data, {"venue": "museum", "camera": CAMERA_TEXT})
        if name == "no pixels":
            assert answer.status_code in (415, 422)
            assert_problem(answer, answer.status_code)
        else:
            assert_problem(answer, status, code)


def test_a_truncated_jpeg_is_refused(museum: Server, queries: list[View]) -> None:
    whole = queries[0].jpeg()
    with museum.unchanged():
        for share in (0.02, 0.3, 0.9):
            answer = museum.post_image(whole[: int(share * len(whole))], {"venue": "museum"})
            assert answer.status_code in (415, 422)
            assert_problem(answer, answer.status_code)


def test_no_image_at_all(museum: Server) -> None:
    with museum.unchanged():
        for request in (
            {"data": {"venue": "museum"}},
            {"json": {"venue": "museum"}},
            {},
        ):
            sentence = assert_problem(museum.client.post("/locate", **request), 422, "invalid_request")
            assert "image" in sentence
        # As `curl -d` sends it.
        text = museum.client.post("/locate", data={"venue": "museum", "image": "a text"})
        assert "curl: -F image=@FILE" in assert_problem(text, 422, "invalid_input")
        # The picture itself as the body, but half of it.
        cut = {"content": b"\xff\xd8", "headers": {"Content-Type": "image/jpeg"}}
        answer = museum.client.post("/locate", params={"venue": "museum"}, **cut)
        assert_problem(answer, 415, "unsupported_image")


def test_a_broken_form_is_refused(museum: Server) -> None:
    for kind in ("multipart/form-data", "multipart/form-data; boundary=x"):
        answer = museum.client.post("/locate", content=b"--x\r\nnonsense", headers={"Content-Type": kind})
        assert answer.status_code in (400, 422)
        assert_problem(answer, answer.status_code)


BAD_CAMERAS = {
    "NaN focal length": "nan,262,159,119",
    "infinite focal length": "inf,262,159,119",
    "zero focal length": "0,0,159,119",
    "negative focal length": "-262,262,159,119",
    "tiny focal length": "3,3,159,119",
    "huge focal length": "1e9,1e9,159,119",
    "unequal focal lengths": "262,900,159,119",
    "principal point at a corner": "262,262,0,0",
    "principal point far outside": "262,262,9000,119",
    "NaN principal point": "262,262,nan,119",
    "three numbers": "262,262,159",
    "five numbers": "262,262,159,119,0",
    "words": "wide,angle,lens,please",
    "a wild lens": "262,262,159,119,1000,0,0,0",
    "no JSON": "{",
    "nested JSON": '{"a":' * 50_000,
    "a model nobody has": json.dumps({"model": "MAGIC", "width": 320, "height": 240, "params": [262] * 4}),
    "a model that is a list": json.dumps({"model": [], "width": 320, "height": 240, "params": [262] * 4}),
    "no params": json.dumps({"model": "PINHOLE", "width": 320, "height": 240}),
    "params that are a number": json.dumps({"model": "PINHOLE", "width": 320, "height": 240, "params": 5}),
    "too few params": json.dumps(
        {"model": "OPENCV", "width": 320, "height": 240, "params": [262, 262, 159, 119]}
    ),
    "no size": json.dumps({"model": "PINHOLE", "width": 0, "height": 0, "params": [262, 262, 159, 119]}),
    "another aspect ratio": json.dumps(
        {"model": "PINHOLE", "width": 320, "height": 180, "params": [262, 262, 159, 89]}
    ),
    "portrait": json.dumps({"model": "PINHOLE", "width": 240, "height": 320, "params": [262, 262, 119, 159]}),
    "a number without end": json.dumps(
        {"model": "PINHOLE", "width": 320, "height": 240, "params": [10**400, 262, 159, 119]}
    ),
}


@pytest.mark.parametrize("name", BAD_CAMERAS)
def test_a_camera_that_can_not_be_is_refused(museum: Server, queries: list[View], name: str) -> None:
    with museum.unchanged():
        fields = {"venue": "museum", "camera": BAD_CAMERAS[name]}
        assert_problem(museum.post_image(queries[0].jpeg(), fields), 422)


@pytest.mark.parametrize("focal_px", [44, 60, 3600])
def test_a_camera_at_the_edge_of_what_is_possible_is_no_error(
    museum: Server, queries: list[View], focal_px: int
) -> None:
    """Zooms that are tried lie beyond it."""
    camera = f"{focal_px},{focal_px},159,119"
    answer = museum.post_image(queries[0].jpeg(), {"venue": "museum", "camera": camera})
    assert answer.status_code == 200, answer.text


BAD_FIELDS = {
    "gravity": [
        "down", "0,0,0", "nan,0,1", "inf,0,1", "1,2", "1,2,3,4", ",,", "[0,1,0]", "1e-9,0,0", "9" * 400 + ",1,1",
    ],
    "prior": [
        "here", "{", "[]", "5", "null", "{}", '{"position": {"x": 1, "y": 2, "z": 3}}', '{"radius_m": 3}',
        '{"position": [1, 2, 3], "radius_m": 3}', '{"position": {"x": "a", "y": 2, "z": 3}, "radius_m": 3}',
        '{"position": {"x": NaN, "y": 2, "z": 3}, "radius_m": 3}',
        '{"position": {"x": 1, "y": 2, "z": 3}, "radius_m": 0}',
        '{"position": {"x": 1, "y": 2, "z": 3}, "radius_m": -1}',
        '{"position": {"x": 1, "y": 2, "z": 3}, "radius_m": Infinity}',
        f'{{"position": {{"x": 1{"0" * 400}, "y": 2, "z": 3}}, "radius_m": 1}}', "[" * 50_000,
    ],
    "method": ["magic", "rgbd ", "AUTO", "{}"],
}  # fmt: skip


@pytest.mark.parametrize("field", BAD_FIELDS)
def test_a_field_that_can_not_be_meant_is_refused(museum: Server, queries: list[View], field: str) -> None:
    with museum.unchanged():
        for value in BAD_FIELDS[field]:
            answer = museum.post_image(queries[0].jpeg(), {"venue": "museum", field: value})
            assert field in assert_problem(answer, 422), value[:50]


@pytest.mark.parametrize(
    "venue", ["nowhere", "../museum", "museum/..", "Museum", "müseum", "m" * 300, "' OR 1=1 --"]
)
def test_an_unknown_venue(museum: Server, queries: list[View], venue: str) -> None:
    with museum.unchanged():
        answer = museum.post_image(queries[0].jpeg(), {"venue": venue})
        assert "venue" in assert_problem(answer, 404, "not_found")


def test_an_unknown_floor(museum: Server, queries: list[View]) -> None:
    answer = museum.post_image(queries[0].jpeg(), {"venue": "museum", "floor": "cellar"})
    assert "cellar" in assert_problem(answer, 404, "not_found")


def test_empty_fields_are_as_good_as_none(museum: Server, queries: list[View]) -> None:
    fields = {"venue": "museum", "floor": "", "camera": "", "gravity": "", "prior": " "}
    assert museum.post_image(queries[0].jpeg(), fields).status_code == 200


@pytest.mark.parametrize(
    "request_",
    [
        ("GET", "/locate", 405),
        ("GET", "/no/such/page", 404),
        ("DELETE", "/venues", 405),
        ("GET", "/venues/nowhere", 404),
        ("GET", "/venues/a%2f..%2fb", 404),
        ("GET", "/venues/" + "x" * 100, 422),
        ("GET", "/venues/%00", 422),
        ("GET", "/venues/museum/floors/none", 404),
        ("GET", "/venues/museum/floors/none/plan", 404),
        ("GET", "/venues/nowhere/floors", 404),
        ("GET", "/venues/nowhere/maps", 404),
        ("POST", "/venues/museum/maps/99/activate", 404),
        ("POST", "/venues/museum/maps/0/activate", 422),
        ("POST", "/venues/museum/maps/latest/activate", 422),
        ("POST", "/venues/museum/maps/99999999999999999999999999/activate", 422),
        ("POST", "/venues/nowhere/maps/1/activate", 404),
        ("GET", "/database/builds/none", 404),
        ("GET", "/database/builds/none/events", 404),
        ("DELETE", "/database/builds/none", 404),
        ("DELETE", "/venues/nowhere", 404),
        ("DELETE", "/venues/museum/floors/none", 404),
    ],
    ids=lambda request_: " ".join(map(str, request_))[:60],
)
def test_addresses_with_nothing_behind_them(museum: Server, request_: tuple[str, str, int]) -> None:
    method, path, status = request_
    with museum.unchanged():
        assert_problem(museum.client.request(method, path), status)


def test_locate_still_works_after_all_that(museum: Server, queries: list[View]) -> None:
    result: dict[str, Any] = museum.locate(queries[0].jpeg(), venue="museum")
    assert result["located"]
