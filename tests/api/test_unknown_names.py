"""Unknown query parameters, form fields, JSON keys and hints: each is named, with the name that was meant."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest
from starlette.testclient import WebSocketDenialResponse

from app.api.requests.names import Known, probably_meant
from tests.api.test_session_stream import connected, sent
from tests.api.test_sessions import start
from tests.scenes import CAMERA_TEXT, View
from tests.server import Server, assert_problem, running

UNKNOWN = "zzyzx"
# Their clients send members of their own.
OTHERS_PROTOCOLS = ("/oscp/geopose",)
POI = {"id": "door", "region_px": [[1, 1], [9, 1], [9, 9]], "position": {"x": 1, "y": 1}, "distance_m": 3}
ANCHOR = {"venue": "v", "floor": "0", "position": {"x": 0, "y": 0}, "height_m": 2, "camera": CAMERA_TEXT}
POSITION = {"x": 1, "y": 2, "z": 3}


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server with the venue `v`, which has no map."""
    with running(tmp_path_factory.mktemp("names"), run_worker=False) as running_server:
        running_server.add_venue("v")
        yield running_server


def operations(server: Server) -> list[tuple[str, str, dict[str, Any]]]:
    """Return method, address and content of the body of every operation in the OpenAPI document."""
    paths = server.client.get("/openapi.json").json()["paths"]
    return [
        (
            method.upper(),
            path.replace("{", "").replace("}", ""),
            call.get("requestBody", {}).get("content", {}),
        )
        for path, calls in paths.items()
        for method, call in calls.items()
    ]


def test_every_operation_refuses_an_unknown_query_parameter(server: Server) -> None:
    calls = operations(server)
    assert len(calls) > 30
    with server.unchanged():
        for method, path, _ in calls:
            answer = server.client.request(method, path, params={UNKNOWN: "1"})
            if method == "HEAD":
                assert answer.status_code == 422
                continue
            assert f"query.{UNKNOWN}" in assert_problem(answer, 422, "invalid_request"), (method, path)


def test_every_form_refuses_an_unknown_field(server: Server) -> None:
    calls = [call for call in operations(server) if "multipart/form-data" in call[2]]
    assert len(calls) >= 7
    with server.unchanged():
        for method, path, _ in calls:
            answer = server.client.request(method, path, data={UNKNOWN: "1"}, files={"image": b"x"})
            assert UNKNOWN in assert_problem(answer, 422, "invalid_request"), (method, path)


def test_every_json_body_refuses_an_unknown_key(server: Server) -> None:
    calls = [call for call in operations(server) if not call[2] or list(call[2]) == ["application/json"]]
    assert len(calls) > 20
    with server.unchanged():
        for method, path, _ in calls:
            if path in OTHERS_PROTOCOLS or method == "HEAD":
                continue
            answer = server.client.request(method, path, json={UNKNOWN: "1"})
            assert UNKNOWN in assert_problem(answer, 422, "invalid_request"), (method, path)


def test_a_call_without_a_body_takes_an_empty_one(server: Server) -> None:
    for body in (
        {"json": {}},
        {"data": {}},
        {"content": b"\xff{", "headers": {"Content-Type": "application/json"}},
    ):
        answer = server.client.post("/venues/v/maps/1/activate", **body)
        assert_problem(answer, 404, "not_found")


def test_the_key_is_checked_before_the_names(tmp_path_factory: pytest.TempPathFactory) -> None:
    with running(tmp_path_factory.mktemp("keyed"), run_worker=False, admin_key="secret") as locked:
        answer = locked.client.post("/locate", data={UNKNOWN: "1"}, files={"image": b"x"})
        assert_problem(answer, 401, "unauthenticated")


@pytest.mark.parametrize(
    ("call", "unknown", "meant"),
    [
        ({"data": {"venu": "v"}}, "venu", "venue"),
        ({"data": {"Venue": "v"}}, "Venue", "venue"),
        ({"data": {"intrinsics": "1"}}, "intrinsics", "camera"),
        ({"files": {"img": b"x"}}, "img", "image"),
        ({"params": {"camera": "1"}}, "query.camera", "the form field camera"),
        ({"params": {"image": "1"}}, "query.image", "the form field image"),
    ],
    ids=str,
)
def test_the_field_of_a_query_that_was_meant_is_named(
    server: Server, call: dict[str, Any], unknown: str, meant: str
) -> None:
    answer = server.client.post("/locate", **{"files": {"image": b"x"}, **call})
    detail = assert_problem(answer, 422, "invalid_request")
    assert detail.startswith(f"{unknown}: ")
    assert f"did you mean {meant}?" in detail
    assert [field["field"] for field in answer.json()["fields"]] == [unknown]


@pytest.mark.parametrize(
    ("fields", "unknown", "meant"),
    [
        ({"depth_scale": "77"}, "depth_scale", "options.depth_scale"),
        ({"gravty": "0,0,1"}, "gravty", "options.gravity"),
        ({"option": "{}"}, "option", "options"),
        ({"options": '{"depth_scal": 77}'}, "options.depth_scal", "depth_scale"),
        ({"options": '{"intrinsics": 77}'}, "options.intrinsics", "camera"),
        ({"options": '{"keyframes": {"every_n": 5}}'}, "options.keyframes.every_n", "every_m"),
    ],
    ids=str,
)
@pytest.mark.parametrize("path", ["/database/build", "/database/calibrate"])
def test_the_option_that_was_meant_is_named(
    server: Server, path: str, fields: dict[str, str], unknown: str, meant: str
) -> None:
    with server.unchanged():
        answer = server.client.post(path, data={"venue": "v", **fields}, files={"archive": ("s.zip", b"PK")})
        detail = assert_problem(answer, 422)
    assert detail.startswith(f"{unknown}: ")
    assert f"did you mean {meant}?" in detail


@pytest.mark.parametrize(
    ("method", "path", "body", "unknown"),
    [
        ("POST", "/venues", {"id": "w", "name": "W", "nmae": "W"}, "nmae"),
        ("PUT", "/venues/v/floors/0", {"name": "G", "level": 0, "z_min": 0, "z_max_m": 3}, "z_min"),
        ("PUT", "/anchors/a", {**ANCHOR, "pois": [POI], "max_age": 3}, "max_age"),
        ("PUT", "/anchors/a", {**ANCHOR, "pois": [POI, {**POI, "distance": 3}]}, "pois.1.distance"),
        ("PUT", "/anchors/a", {**ANCHOR, "position": {**POSITION}, "pois": [POI]}, "position.z"),
        ("POST", "/sessions", {"venue": "v", "lang": "de"}, "lang"),
        ("PATCH", f"/sessions/{'0' * 32}", {"destinaton": "x"}, "destinaton"),
    ],
    ids=str,
)
def test_the_key_of_a_json_body_is_named_by_its_path(
    server: Server, method: str, path: str, body: dict[str, Any], unknown: str
) -> None:
    with server.unchanged():
        answer = server.client.request(method, path, json=body)
        detail = assert_problem(answer, 422, "invalid_request")
    assert detail.startswith(f"{unknown}: this field is not known; ")


@pytest.mark.parametrize(
    ("field", "value", "unknown"),
    [
        ("prior", {"position": POSITION, "radius": 3}, "prior.radius"),
        ("prior", {"position": {**POSITION, "w": 1}, "radius_m": 3}, "prior.position.w"),
    ],
    ids=str,
)
def test_an_unknown_key_of_a_prior_is_named(server: Server, field: str, value: object, unknown: str) -> None:
    answer = server.post_image(b"x", {field: json.dumps(value)})
    assert assert_problem(answer, 422, "invalid_input").startswith(f"{unknown}: ")


def test_an_unknown_key_of_a_motion_is_named(server: Server) -> None:
    motion = {"position": POSITION, "quaternion": {"x": 0, "y": 0, "z": 0, "w": 1}}
    for value, unknown in (
        ({**motion, "rotation": []}, "motion.rotation"),
        ({**motion, "quaternion": {**motion["quaternion"], "qw": 1}}, "motion.quaternion.qw"),
    ):
        answer = server.client.post(
            f"/sessions/{'0' * 32}/frames", data={"motion": json.dumps(value)}, files={"image": b"x"}
        )
        assert assert_problem(answer, 422, "invalid_input").startswith(f"{unknown}: ")


def test_an_unknown_hint_is_named_and_the_stream_goes_on(museum: Server, queries: list[View]) -> None:
    with connected(museum, start(museum)) as socket:
        socket.send_text(json.dumps({"timestmp": 1}))
        problem = socket.receive_json()
        assert (problem["status"], problem["code"]) == (422, "invalid_input")
        assert problem["detail"] == "timestmp: this field is not known; did you mean timestamp?"
        assert sent(socket, queries[0], 0.0)["frame"] == 1


def test_an_unknown_query_parameter_of_a_stream_is_named(server: Server) -> None:
    session = start(server, "v")
    with pytest.raises(WebSocketDenialResponse) as refused, connected(server, session, "?keys=x"):
        pass
    assert refused.value.status_code == 422
    assert refused.value.json()["detail"] == "keys: this field is not known; the call takes none"


def test_hostile_names_are_repeated_in_part_and_without_control_characters(server: Server) -> None:
    names = [*(letter * 2000 for letter in "ABCDE"), "\x00\x1b[2J\u202e", "{message}", "%s"]
    body = dict.fromkeys(names, 1)
    answers = [
        server.client.post("/venues", json={"id": "w", "name": "W", **body}),
        server.client.post("/venues", json={"id": "w", "name": "W", **dict(reversed(body.items()))}),
        server.client.post("/locate", data=dict.fromkeys(names, "1"), files={"image": b"x"}),
        server.client.get("/venues", params=dict.fromkeys(names[:1], "1")),
        server.client.post(
            "/database/build", data={"venue": "v", "options": json.dumps(body)}, files={"archive": b"x"}
        ),
    ]
    for answer in answers:
        assert assert_problem(answer, 422).isprintable()
        assert len(answer.content) < 2000


def test_the_name_that_is_most_alike_is_meant() -> None:
    known = {
        "camera": Known("camera", "Intrinsics: fx,fy,cx,cy"),
        "depth_scale": Known("options.depth_scale"),
        "depth_camera": Known("options.depth_camera"),
    }
    assert probably_meant("depth-scale", known) == "options.depth_scale"
    assert probably_meant("DEPTH_CAM", known) == "options.depth_camera"
    assert probably_meant("intrinsics", known) == "camera"
    # Parts of formulas in a description are no names.
    assert probably_meant("fx", known) is None
    assert probably_meant("trajectory", known) is None
    assert probably_meant("", known) is None


def test_a_name_that_is_given_too_was_not_meant(server: Server) -> None:
    pose = {"position": POSITION, "rotation": {"x": 0, "y": 0, "z": 0, "w": 1}}
    form = {"venue": "v", "axes": "arkit", "device_pose": json.dumps(pose)}
    answer = server.client.post("/locate", data=form, files={"image": b"no picture"})
    assert assert_problem(answer, 422) == (
        "device_pose.rotation: this field is not known; there are position, quaternion"
    )


@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("/locate", "-F image=@FILE), or the picture alone"),
        ("/database/build", "-F archive=@FILE)."),
        ("/venues/v/floors/0/plan", "-F image=@FILE), or the picture alone"),
    ],
)
def test_a_form_that_can_hold_no_file_says_which_can(server: Server, path: str, said: str) -> None:
    """`curl -d` and `--data-binary` send such a form unless they are told otherwise."""
    method = "PUT" if path.endswith("plan") else "POST"
    for content in (b"image=photo.jpg", b"\xff\xd8\xff\xe0JFIF"):
        answer = server.client.request(
            method, path, content=content, headers={"Content-Type": "application/x-www-form-urlencoded"}
        )
        detail = assert_problem(answer, 422, "invalid_input")
        assert said in detail
        assert "send multipart/form-data" in detail
