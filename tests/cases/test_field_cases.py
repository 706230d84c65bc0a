"""All inputs from the field by one command: `pytest tests/cases`. Each is sent to a server and judged by its README."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.geometry.se3 import Pose
from tests.cases.field_cases import (
    CAMERA,
    FOLDER,
    RIGHT,
    RIGHT_DEG,
    RIGHT_M,
    VENUE,
    ScanCase,
    build,
    folder_of,
    json_of,
    locate,
    located_as_right,
    options_of,
    pictures_of,
    rounded,
    says,
    sentence_of,
)
from tests.server import Server, assert_problem, assert_sentence, pose_errors, running

pytestmark = pytest.mark.skipif(
    not FOLDER.is_dir(), reason="the cases from the field are not beside the repository"
)

SCANS = [
    ScanCase(name="00-right", readable=True),
    ScanCase(name="01-opengl-axes", refusal=("axes|opengl|arkit",)),
    ScanCase(name="02-world-to-camera", refusal=("invert|inverse|camera_from_world|world to camera",)),
    ScanCase(name="03-quaternion-wxyz", refusal=("qw|wxyz|w x y z|scalar|order of the quaternion",)),
    ScanCase(name="04-depth-in-mm-read-as-5000", refusal=("depth", r"\b5(\.0\d*)? times|1000")),
    ScanCase(name="06-portrait-frames-landscape-poses", refusal=("turned|rotated|quarter|portrait",)),
    ScanCase(name="07-one-time-for-all", refusal=("groundtruth.txt", "1305030000", "more digits")),
    ScanCase(name="08-extra-columns-3x4", readable=True, refusal=("groundtruth.txt", "13")),
    ScanCase(
        name="09-poses-one-frame-late",
        refusal=("late|early|time|offset",),
        warning=("late|early|time offset",),
    ),
    ScanCase(name="10-gravity-points-up", refusal=("gravity", "down"), warning=("gravity", "down")),
    ScanCase(name="14-png-rotation-behind-the-pixels", refusal=("00.png", "rotation")),
    ScanCase(name="20-decimal-commas", readable=True, refusal=("groundtruth.txt", "line 1", "comma")),
    ScanCase(name="22-nanoseconds", readable=True, refusal=("rgb.txt", "groundtruth.txt", "nanoseconds")),
    ScanCase(name="24-associations-as-rgb-txt", readable=True, refusal=("rgb/00.jpg",)),
    ScanCase(name="25-depth-tiff-float", readable=True, refusal=("00.tiff", "16")),
    ScanCase(name="28-7scenes-3x4-pose", readable=True, refusal=("12 numbers", "16")),
    ScanCase(name="30-folder-beside-a-readme", readable=True),
    ScanCase(name="32-names-decomposed", readable=True),
    ScanCase(name="34-upper-case-files", readable=True, refusal=("00.jpg",)),
    ScanCase(name="36-same-entry-twice", readable=True, refusal=("rgb.txt", "twice")),
    ScanCase(name="37-trajectory-under-another-name", readable=True, refusal=("CameraTrajectory.txt",)),
    ScanCase(name="40-scannet", readable=True, refusal=("scannet",), keeps_frame=False),
    ScanCase(name="41-stray-scanner", readable=True, refusal=("stray scanner", "tum"), keeps_frame=False),
    ScanCase(name="42-polycam-raw", readable=True, refusal=("polycam", "tum"), keeps_frame=False),
    ScanCase(
        name="44-nerfstudio-transforms", readable=True, refusal=("nerfstudio", "tum"), keeps_frame=False
    ),
    ScanCase(name="46-open3d-redwood", readable=True, refusal=("open3d|redwood", "tum"), keeps_frame=False),
]
# What is not right yet, and why.
OPEN: dict[str, str] = {}


def listed(names: list[str]) -> list[Any]:
    return [
        pytest.param(
            name, id=name, marks=pytest.mark.xfail(strict=False, reason=OPEN[name]) if name in OPEN else ()
        )
        for name in names
    ]


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server with the map of the right scan."""
    with running(tmp_path_factory.mktemp("cases")) as running_server:
        running_server.add_venue(VENUE)
        right = build(running_server, VENUE, folder_of(RIGHT) / "scan-right.zip", {})
        assert right["state"] == "succeeded", right
        yield running_server


@pytest.mark.parametrize("name", listed([case.name for case in SCANS]))
def test_a_scan(server: Server, name: str) -> None:
    case = next(case for case in SCANS if case.name == name)
    venue = server.add_venue(f"v{name}")
    (archive,) = folder_of(name).glob("*.zip")
    built = build(server, venue, archive, options_of(name))
    if built["state"] == "failed":
        assert_sentence(sentence_of(built))
        assert says(sentence_of(built), case.refusal), sentence_of(built)
        return
    warned = json.dumps([built["report"].get(key) for key in ("warnings", "notes", "examination")])
    if says(warned, case.warning):
        return
    assert case.readable, built["report"]
    assert located_as_right(server, venue, case.keeps_frame) == ""


def test_every_case_is_tried() -> None:
    """A folder that no test names would be forgotten."""
    source = Path(__file__).read_text(encoding="utf-8")
    assert not [path.name for path in FOLDER.iterdir() if path.is_dir() and f'"{path.name}"' not in source]


def query_truths(name: str) -> list[Pose]:
    return [
        Pose.from_matrix(rounded(matrix))
        for matrix in json_of(name, "request.json")["truth_world_from_camera"]
    ]


@pytest.mark.parametrize("name", listed(["57-heic", "59-12-bit-in-16-bit-png"]))
def test_a_picture_is_read(server: Server, name: str) -> None:
    for picture, truth in zip(pictures_of(name), query_truths(name), strict=True):
        answer = locate(server, picture, VENUE)
        assert answer.get("located"), answer
        error_m, error_deg = pose_errors(answer, truth)
        assert error_m < 2 * RIGHT_M
        assert error_deg < 2 * RIGHT_DEG


@pytest.mark.parametrize(
    "name",
    listed(
        [
            "50-exif6-sensor-intrinsics",
            "52-16x9-crop-4x3-intrinsics",
            "53-twice-as-large-as-its-intrinsics",
            "54-digital-zoom-1.25",
        ]
    ),
)
def test_a_camera_that_is_not_the_pictures_own_is_not_believed(server: Server, name: str) -> None:
    """It is refused with the likely cause, or mended, or the answer knows how wrong it may be."""
    camera = json_of(name, "request.json")["camera"]
    for picture, truth in zip(pictures_of(name), query_truths(name), strict=True):
        answer = locate(server, picture, VENUE, camera)
        if answer["status"] == 422:
            assert_sentence(answer["detail"])
            assert says(answer["detail"], ("principal point|intrinsics|focal|camera",)), answer["detail"]
        elif answer["located"]:
            error_m, error_deg = pose_errors(answer, truth)
            accuracy = answer["accuracy"]
            stated = error_m < 3 * accuracy["position_m"] and error_deg < 3 * accuracy["orientation_deg"]
            assert stated or answer["confidence"] < 0.5, (error_m, error_deg, accuracy, answer["confidence"])


@pytest.fixture(scope="module")
def floor(server: Server) -> str:
    """A venue with a floor without a plan."""
    server.add_venue("plans")
    body = {"name": "g", "level": 0, "z_min_m": -1, "z_max_m": 2}
    assert server.client.put("/venues/plans/floors/0", json=body).status_code == 200
    return "/venues/plans/floors/0"


def put_features(server: Server, floor: str, name: str) -> httpx.Response:
    return server.client.put(f"{floor}/features", json=json_of(name, "features.json"))


@pytest.mark.parametrize("name", listed(["61-lonlat-landmarks-without-origin"]))
def test_longitude_and_latitude_need_an_origin(server: Server, floor: str, name: str) -> None:
    assert says(assert_problem(put_features(server, floor, name), 422), ("longitude|degrees|lon", "origin"))


@pytest.mark.parametrize("name", listed(["62-multipolygon-of-one-part"]))
def test_a_multipolygon_of_one_part_is_taken(server: Server, floor: str, name: str) -> None:
    answer = put_features(server, floor, name)
    assert answer.status_code == 200, answer.text


@pytest.mark.parametrize("name", listed(["65-null-id-in-properties"]))
def test_a_null_id_hides_no_id(server: Server, floor: str, name: str) -> None:
    assert put_features(server, floor, name).status_code == 200
    features = server.client.get(f"{floor}/features").json()["features"]
    assert {feature.get("id", feature["properties"].get("id")) for feature in features} == {"ent"}


@pytest.mark.parametrize("name", listed(["66-plan-points-in-pixels"]))
def test_plan_points_in_pixels_are_refused(server: Server, name: str) -> None:
    server.add_venue("pixels")
    answer = server.client.put("/venues/pixels/floors/0", json=json_of(name, "floor.json"))
    assert says(assert_problem(answer, 422), ("pixel|mirror|y up|y is up|upwards",))


@pytest.mark.parametrize("name", listed(["70-part-without-filename"]))
def test_a_part_without_a_file_name(server: Server, name: str) -> None:
    body = (folder_of(name) / "body.bin").read_bytes()
    headers = {"Content-Type": "multipart/form-data; boundary=xyz"}
    answer = server.client.post("/locate", content=body, headers=headers)
    if answer.status_code == 422:
        assert says(assert_problem(answer, 422), ("file ?name",))
    else:
        assert answer.status_code == 200, answer.text


@pytest.mark.parametrize("name", listed(["71-fields-that-are-ignored"]))
def test_fields_that_nobody_knows_are_named(server: Server, name: str) -> None:
    scan = (folder_of(RIGHT) / "scan-right.zip").read_bytes()
    picture = pictures_of(RIGHT)[0].read_bytes()
    image = {"image": ("q.jpg", picture)}
    answers = {
        "depth_scale": server.client.post(
            "/database/build",
            data={"venue": VENUE, "depth_scale": "77"},
            files={"archive": ("scan.zip", scan)},
        ),
        "camera": server.client.post("/locate", params={"venue": VENUE, "camera": CAMERA}, files=image),
        "intrinsics": server.client.post("/locate", data={"venue": VENUE, "intrinsics": CAMERA}, files=image),
    }
    for field, answer in answers.items():
        assert field in assert_problem(answer, 422), name


@pytest.mark.parametrize("name", listed(["74-colmap-default-models"]))
def test_the_models_of_colmap(server: Server, name: str) -> None:
    models = {
        "SIMPLE_PINHOLE": [300, 159.5, 119.5],
        "SIMPLE_RADIAL": [300, 159.5, 119.5, 0.0],
        "RADIAL": [300, 159.5, 119.5, 0.0, 0.0],
    }
    picture = pictures_of(RIGHT)[0]
    for model, params in models.items():
        camera = json.dumps({"model": model, "width": 320, "height": 240, "params": params})
        answer = locate(server, picture, VENUE, camera)
        assert answer["status"] == 200, (name, answer)
        assert answer["located"], (name, model)


@pytest.mark.parametrize("name", listed(["76-content-type-in-capitals"]))
def test_a_media_type_in_capitals(server: Server, floor: str, name: str) -> None:
    body = {
        "venue": "plans",
        "floor": "0",
        "position": {"x": 0, "y": 0},
        "height_m": 2.0,
        "camera": {"model": "PINHOLE", "width": 320, "height": 240, "params": [300, 300, 159.5, 119.5]},
        "pois": [
            {
                "id": "door",
                "region_px": [[10, 10], [60, 10], [60, 60]],
                "position": {"x": 2, "y": 0},
                "distance_m": 2.5,
            }
        ],
    }
    put = server.client.put("/anchors/capitals", json=body)
    assert put.status_code in (200, 201), put.text
    picture = pictures_of(RIGHT)[0].read_bytes()
    content = b"\r\n".join(
        [
            b"--xyz",
            b'Content-Disposition: form-data; name="image"; filename="q.jpg"',
            b"Content-Type: image/jpeg",
            b"",
            picture,
            b"--xyz--",
            b"",
        ]
    )
    for kind in ("multipart/form-data", "Multipart/Form-Data"):
        headers = {"Content-Type": f"{kind}; boundary=xyz"}
        answer = server.client.post("/anchors/capitals/frames", content=content, headers=headers)
        assert answer.status_code == 200, (name, kind, answer.text)


@pytest.mark.parametrize("name", listed(["77-sqlite-locked"]))
def test_a_locked_database_is_busy(tmp_path: Path, name: str) -> None:
    """A server of its own: the lock would stop the worker of the others."""
    with running(tmp_path / "locked", run_worker=False) as alone:
        lock = sqlite3.connect(tmp_path / "locked" / "roomfix.db", isolation_level=None)
        try:
            lock.execute("BEGIN IMMEDIATE")
            answer = alone.client.post("/venues", json={"id": "a", "name": "A"})
        finally:
            lock.close()
        assert_problem(answer, 503)
        assert int(answer.headers["Retry-After"]) > 0, name
        assert alone.client.post("/venues", json={"id": "a", "name": "A"}).status_code == 201


@pytest.mark.parametrize("name", listed(["78-y-up-world-without-gravity"]))
def test_without_a_known_up_there_is_no_plan(server: Server, name: str) -> None:
    floor = {
        "name": "g",
        "level": 0,
        "z_min_m": -10,
        "z_max_m": 10,
        "plan_from_world": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
    }
    assert server.client.put(f"/venues/{VENUE}/floors/up", json=floor).status_code == 200
    try:
        answer = locate(server, pictures_of(RIGHT)[0], VENUE)
    finally:
        assert server.client.delete(f"/venues/{VENUE}/floors/up").status_code in (200, 204)
    assert answer["located"], name
    assert answer["pose"] is not None
    assert answer["plan"] is None
    assert says(json.dumps(answer), ("up",))


@pytest.mark.parametrize("name", listed(["79-replace-a-good-map"]))
def test_a_good_map_is_not_replaced_by_one_that_contradicts_it(server: Server, name: str) -> None:
    venue = server.add_venue("replaced")
    right = build(server, venue, folder_of(RIGHT) / "scan-right.zip", {})
    assert right["state"] == "succeeded"
    wrong = build(server, venue, folder_of("01-opengl-axes") / "scan.zip", {"mode": "replace"})
    assert wrong["state"] == "failed", name
    assert located_as_right(server, venue, keeps_frame=True) == ""
