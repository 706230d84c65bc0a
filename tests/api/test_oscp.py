"""The GeoPose protocol of OSCP: both versions answer as /locate, and what can't be answered says why."""

from __future__ import annotations

import base64
import copy
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from app.api.oscp.request import REQUEST, GeoPoseRequest
from app.api.oscp.response import GeoPoseResponse
from tests.api.test_locate import put_floor
from tests.scenes import CAMERA, View, encode
from tests.server import Server, assert_problem

PAGE = Path(__file__).parents[2] / "docs" / "where-on-earth.md"
ORIGIN = {"latitude": 47.3782, "longitude": 8.5402, "height_m": 455.2, "heading_deg": 35.0}
# A second venue 2 km to the north, and one 60 m from the first.
FAR = {**ORIGIN, "latitude": 47.3962}
NEAR = {**ORIGIN, "latitude": 47.37874}
PRIVACY = {
    "dataRetention": [], "dataAcceptableUse": [], "dataSanitizationApplied": [], "dataSanitizationRequested": [],
}  # fmt: skip
PARAMS = {"model": "PINHOLE", "modelParams": list(CAMERA.params)}
SIZE = [CAMERA.width, CAMERA.height]


def text(data: bytes) -> str:
    return base64.b64encode(data).decode()


def version_2(image: bytes, **changes: Any) -> dict[str, Any]:
    """Return a request as the Python client of the protocol's repository sends it."""
    reading = {
        "timestamp": 1.6e12, "sensorId": "my_camera_sensor", "privacy": PRIVACY, "sequenceNumber": 1,
        "imageFormat": "RGBA32", "size": SIZE, "imageBytes": text(image),
        "imageOrientation": {"mirrored": False, "rotation": 0.0},
        "params": {**PARAMS, "minMaxDepth": [], "minMaxDisparity": []},
        **changes,
    }  # fmt: skip
    position = {
        "timestamp": 1.6e12, "sensorId": "my_gps_sensor", "privacy": PRIVACY, "latitude": 47.3783, "longitude": 8.5403,
        "altitude": 450.0, "accuracy": 0.0, "altitudeAccuracy": 0.0, "heading": 0.0, "speed": 0.0,
    }  # fmt: skip
    return {
        "type": "geopose", "id": "a request", "timestamp": 1.6e12,
        "sensors": [{"type": "camera", "id": "my_camera_sensor"}, {"type": "geolocation", "id": "my_gps_sensor"}],
        "sensorReadings": {"cameraReadings": [reading], "geolocationReadings": [position], "wifiReadings": []},
        "priorPoses": [],
    }  # fmt: skip


def version_1(image: bytes) -> dict[str, Any]:
    """Return a request as the web client of version 1 has it in its example."""
    when = "2020-12-26T15:19:50.381Z"
    return {
        "id": "d9fbf438", "timestamp": when, "type": "geopose",
        "sensors": [{"id": "0", "type": "camera", "params": PARAMS}, {"id": "1", "type": "geolocation"}],
        "sensorReadings": [
            {
                "sensorId": "0", "timestamp": when, "privacy": PRIVACY,
                "reading": {
                    "sequenceNumber": 0, "imageFormat": "JPG", "size": SIZE, "imageBytes": text(image),
                    "imageOrientation": {"mirrored": False, "rotation": 0},
                },
            },
            {"sensorId": "2", "timestamp": when, "reading": {"x": 0.0, "y": 9.81, "z": 0.0}},
            {
                "sensorId": "1", "timestamp": when, "privacy": PRIVACY,
                "reading": {
                    "latitude": 47.3783, "longitude": 8.5403, "altitude": 0, "accuracy": 0, "altitudeAccuracy": 0,
                    "heading": 0, "speed": 0,
                },
            },
        ],
    }  # fmt: skip


def ask(server: Server, request: Any, venue: str | None = None, **headers: str) -> httpx.Response:
    params = {} if venue is None else {"venue": venue}
    return server.client.post("/oscp/geopose", json=request, params=params, headers=headers)


@pytest.fixture(scope="module")
def oscp(museum: Server) -> Iterator[Server]:
    """The server with the venue `museum` on Earth, on a floor with a plan."""
    put_floor(museum, "museum", "oscp", 0.0, 2.6, plan_from_world=np.eye(4).tolist())
    assert museum.client.patch("/venues/museum", json={"origin": ORIGIN}).status_code == 200
    yield museum
    museum.client.patch("/venues/museum", json={"origin": None})
    museum.client.delete("/venues/museum/floors/oscp")


@pytest.mark.parametrize("make", [version_1, version_2])
def test_the_answer_is_that_of_locate(oscp: Server, queries: list[View], make: Any) -> None:
    image = queries[0].jpeg()
    answer = ask(oscp, make(image))
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"] == "application/json"
    body = answer.json()
    assert set(body) == {"id", "timestamp", "type", "accuracy", "geopose"}
    assert (body["id"], body["type"]) == (make(image)["id"], "geopose")
    camera = '{"model": "PINHOLE", "width": 320, "height": 240, "params": [262.5, 262.5, 159.5, 119.5]}'
    located = oscp.locate(image, venue="museum", camera=camera)
    expected = located["geopose"]
    # A millimetre is 1e-8 degrees.
    for name, tolerance in (("lat", 9e-9), ("lon", 9e-9), ("h", 1e-3)):
        assert body["geopose"]["position"][name] == pytest.approx(expected["position"][name], abs=tolerance)
    assert body["geopose"]["quaternion"] == pytest.approx(expected["quaternion"], abs=1e-6)
    assert body["accuracy"]["position"] == pytest.approx(located["accuracy"]["position_m"])
    # By minutes, since a test must not fail for its clock.
    assert abs(body["timestamp"] - 1.7e12) < 1e12
    GeoPoseResponse.model_validate(body)


def test_the_version_is_negotiated(oscp: Server, queries: list[View]) -> None:
    request = version_2(queries[0].jpeg())
    answer = ask(oscp, request, Accept="application/vnd.oscp+json; version=2.0")
    assert answer.headers["content-type"] == "application/vnd.oscp+json; version=2.0"
    sentence = assert_problem(ask(oscp, request, Accept="application/vnd.oscp+json; version=3.0"), 422)
    assert "1.0 and 2.0" in sentence
    # More digits than Python makes a number of.
    long = ask(oscp, request, Accept=f"application/vnd.oscp+json; version={'9' * 5000}")
    assert "1.0 and 2.0" in assert_problem(long, 422)


def test_pixels_without_a_file(oscp: Server, queries: list[View]) -> None:
    png = ask(oscp, version_2(queries[0].png(), imageFormat="PNG")).json()["geopose"]
    rgba = np.dstack([queries[0].rgb, np.full(queries[0].rgb.shape[:2], 7, np.uint8)]).tobytes()
    found = ask(oscp, version_2(rgba)).json()
    assert found["geopose"]["position"] == pytest.approx(png["position"], abs=1e-9)
    gray = queries[0].rgb.mean(axis=2).astype(np.uint8).tobytes()
    assert ask(oscp, version_2(gray, imageFormat="GRAY8")).status_code == 200
    short = assert_problem(ask(oscp, version_2(rgba[:-1])), 422, "invalid_image")
    assert "320 x 240" in short
    assert "size" in assert_problem(ask(oscp, version_2(rgba, size=None)), 422, "invalid_input")


def test_what_is_not_known_of_the_camera_is_found(oscp: Server, queries: list[View]) -> None:
    image = queries[0].jpeg()
    for params in (
        None,
        {"model": "UNKNOWN", "modelParams": []},
        {"model": "UNKNOWN_CAMERA", "modelParams": [1]},
    ):
        assert ask(oscp, version_2(image, params=params)).status_code in (200, 404)
    without_size = ask(oscp, version_2(image, imageFormat="JPG", size=[0, 0]))
    assert without_size.status_code == 200
    fov = version_2(image, params={"model": "FOV", "modelParams": [262.5, 262.5, 159.5, 119.5, 0.1]})
    assert "PINHOLE" in assert_problem(ask(oscp, fov), 422, "invalid_input")
    few = version_2(image, params={"model": "PINHOLE", "modelParams": [262.5]})
    assert_problem(ask(oscp, few), 422, "invalid_camera")


def test_a_picture_that_can_not_be_placed(oscp: Server) -> None:
    black = encode(np.zeros((240, 320, 3), np.uint8), ".png")
    assert "poor_image" in assert_problem(ask(oscp, version_2(black)), 404, "not_located")


def bad_requests() -> dict[str, tuple[dict[str, Any], int, str]]:
    """Return requests that can't be answered, with status and code."""
    own = version_2(b"\xff\xd8\xff")
    half = encode(np.full((60, 80, 3), 200, np.uint8), ".png")[:50]
    none = copy.deepcopy(own)
    none["sensorReadings"]["cameraReadings"] = []
    nowhere = copy.deepcopy(own)
    nowhere["sensorReadings"]["geolocationReadings"][0]["latitude"] = 91
    return {
        "no picture": (none, 422, "invalid_input"),
        "no reading": ({**own, "sensorReadings": []}, 422, "invalid_input"),
        "readings of another kind": ({**own, "sensorReadings": "all"}, 422, "invalid_request"),
        "no id": ({name: own[name] for name in own if name != "id"}, 422, "invalid_request"),
        "a latitude above the pole": (nowhere, 422, "invalid_request"),
        "not base64": (version_2(b"", imageBytes="!"), 422, "invalid_input"),
        "no image": (version_2(b"not an image"), 415, "unsupported_image"),
        "half an image": (version_2(half), 422, "invalid_image"),
        "depth": (version_2(b"\xff\xd8\xff", imageFormat="DEPTH"), 422, "invalid_input"),
        "mirrored": (
            version_2(b"\xff\xd8\xff", imageOrientation={"mirrored": True, "rotation": 0}),
            422,
            "invalid_input",
        ),
        "a bad prior pose": ({**own, "priorPoses": [{"id": "x"}]}, 422, "invalid_request"),
    }


@pytest.mark.parametrize("name", bad_requests())
def test_requests_that_can_not_be_answered(oscp: Server, name: str) -> None:
    request, status, code = bad_requests()[name]
    request.setdefault("sensorReadings", {})
    if name == "no image":
        request["sensorReadings"]["cameraReadings"][0]["imageFormat"] = "JPG"
    assert_problem(ask(oscp, request, venue="museum"), status, code)


def test_the_venue_is_the_nearest_one(empty: Server) -> None:
    """Which venue was chosen is seen in the metrics of its answers, all of which are `no_map`."""
    request = version_2(encode(np.zeros((240, 320, 3), np.uint8), ".png"))

    def chosen(**position: float) -> str:
        asked = copy.deepcopy(request)
        asked["sensorReadings"]["geolocationReadings"][0] |= position
        answer = ask(empty, asked)
        return f"{answer.status_code} {answer.json()['code']}"

    assert chosen() == "404 no_venue"
    for venue, origin in (("town", ORIGIN), ("hill", FAR), ("attic", None)):
        empty.client.post("/venues", json={"id": venue, "name": venue, "origin": origin})
    assert chosen() == "404 not_located"
    assert chosen(latitude=48.0) == "404 no_venue"
    # The second one is 2 km away: a position that is off by 1,100 m may be nearer to it.
    assert chosen(accuracy=500) == "404 not_located"
    assert chosen(accuracy=1100) == "409 ambiguous_venue"
    empty.client.post("/venues", json={"id": "next", "name": "next", "origin": NEAR})
    assert chosen(latitude=47.3782) == "409 ambiguous_venue"
    assert chosen(latitude=47.3782, accuracy=10) == "404 not_located"
    assert 'venue="town"' in empty.client.get("/metrics").text
    assert 'venue="next"' not in empty.client.get("/metrics").text
    named = ask(empty, request, venue="attic")
    assert_problem(named, 404, "not_located")
    assert_problem(ask(empty, request, venue="none"), 404, "not_found")


def test_without_a_position_there_must_be_one_venue(empty: Server) -> None:
    request = version_2(encode(np.zeros((240, 320, 3), np.uint8), ".png"))
    del request["sensorReadings"]["geolocationReadings"]
    empty.client.post("/venues", json={"id": "town", "name": "town", "origin": ORIGIN})
    assert_problem(ask(empty, request), 404, "not_located")
    empty.client.post("/venues", json={"id": "hill", "name": "hill", "origin": FAR})
    assert "geolocation" in assert_problem(ask(empty, request), 422, "invalid_input")
    pose = {
        "position": {"lat": 47.3783, "lon": 8.5403, "h": 0},
        "quaternion": {"x": 0, "y": 0, "z": 0, "w": 1},
    }
    request["priorPoses"] = [
        {"id": "x", "timestamp": 1, "type": "geopose", "accuracy": None, "geopose": pose}
    ]
    assert_problem(ask(empty, request), 404, "not_located")


def test_a_venue_that_has_no_place_on_earth(leaning: Server, queries: list[View]) -> None:
    request = version_2(queries[0].jpeg())
    before = leaning.client.get("/venues/leaning").json()["origin"]
    leaning.client.patch("/venues/leaning", json={"origin": None})
    assert "origin" in assert_problem(ask(leaning, request, venue="leaning"), 409, "conflict")
    leaning.client.patch("/venues/leaning", json={"origin": ORIGIN})
    assert "gravity" in assert_problem(ask(leaning, request, venue="leaning"), 409, "conflict")
    leaning.client.patch("/venues/leaning", json={"origin": before})


def test_a_picture_may_be_larger_than_other_json(oscp: Server) -> None:
    large = version_2(
        encode(np.random.default_rng(1).integers(0, 255, (700, 900, 3), dtype=np.uint8), ".png")
    )
    large["sensorReadings"]["cameraReadings"][0] |= {"params": None, "imageFormat": "PNG"}
    assert len(large["sensorReadings"]["cameraReadings"][0]["imageBytes"]) > 1_500_000
    assert_problem(ask(oscp, large), 404, "not_located")


def test_the_call_of_the_page_is_answered(oscp: Server, queries: list[View]) -> None:
    block = next(
        each for each in PAGE.read_text(encoding="utf-8").split("```") if "/oscp/geopose" in each[:30]
    )
    body = block.partition("-d '")[2].rpartition("'")[0]
    picture = "'$(base64 -w0 photo.jpg)'"
    assert picture in body
    request = json.loads(body.replace(picture, text(queries[0].jpeg())))
    answer = ask(oscp, request)
    assert answer.status_code == 200, answer.text
    assert answer.json()["geopose"]["position"]["lat"] == pytest.approx(ORIGIN["latitude"], abs=1e-3)


def test_the_example_of_the_schema_is_read() -> None:
    read = GeoPoseRequest.model_validate(REQUEST)
    assert read.version == 2
    found = read.picture()
    assert found is not None
    assert found[1] is not None
    assert read.geolocation() is not None
