"""POST /locate with photos as phones send them: EXIF instead of intrinsics, turned, in any size."""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
import pytest
from PIL import Image

from app.geometry.camera import Camera
from app.geometry.focal import pinhole
from app.geometry.se3 import Pose
from app.geometry.turns import camera_from_turned
from app.vision.exif import EXIF_IFD, FOCAL_35MM, MAKE, MODEL
from tests.api.test_locate import pose_errors
from tests.scenes import CAMERA, Room, View, pose_at, scan_files, zipped
from tests.server import Server, assert_problem

# A corner: before one flat wall alone, distance and focal length can't be told apart.
CORNER = pose_at(1.7, 1.4, 1.45, 28.0, 2.0)
# What the synthetic camera is on 35 mm film, by the diagonal.
FOCAL_35 = CAMERA.focal_px / 400 * 43.2666


def photo(rgb: np.ndarray[Any, Any], base: dict[int, Any], own: dict[int, Any] | None = None) -> bytes:
    exif = Image.Exif()
    for tag, value in base.items():
        exif[tag] = value
    exif[EXIF_IFD] = own or {}
    buffer = io.BytesIO()
    Image.fromarray(rgb).save(buffer, "JPEG", quality=92, exif=exif)
    return buffer.getvalue()


def post(server: Server, image: bytes, venue: str = "museum", **fields: str) -> dict[str, Any]:
    answer = server.post_image(image, {"venue": venue, **fields})
    assert answer.status_code == 200, answer.text
    return dict(answer.json())


def down_in_camera(world_from_camera: Pose) -> str:
    return ",".join(f"{value:.6f}" for value in 9.81 * world_from_camera.rotation.T @ [0.0, 0.0, -1.0])


@pytest.mark.parametrize("error", [0.0, 0.03, -0.03, 0.08, -0.08])
def test_exif_gives_a_rough_focal_length_that_is_refined(museum: Server, room: Room, error: float) -> None:
    view = room.view(CORNER)
    result = post(museum, photo(view.rgb, {}, {FOCAL_35MM: round(FOCAL_35 * (1 + error), 1)}))
    assert result["located"], result
    assert result["camera"]["source"] == "exif"
    assert result["camera"]["params"][0] == pytest.approx(CAMERA.focal_px, rel=0.03)
    assert pose_errors(result, CORNER)[0] < 0.06


def test_a_phone_that_is_known_by_name(museum: Server, room: Room) -> None:
    focal_px = 28 / 43.2666 * 400
    view = room.view(CORNER, pinhole(320, 240, focal_px))
    result = post(museum, photo(view.rgb, {MAKE: "Apple", MODEL: "iPhone 8"}))
    assert result["camera"]["source"] == "phone_database"
    assert result["camera"]["params"][0] == pytest.approx(focal_px, rel=0.03)
    assert pose_errors(result, CORNER)[0] < 0.06


def test_exif_that_lies_does_not_mislead(museum: Server, room: Room) -> None:
    view = room.view(CORNER)
    result = post(museum, photo(view.rgb, {}, {FOCAL_35MM: 60}))
    assert result["located"], result["reason"]
    assert result["camera"]["source"] == "search"
    assert pose_errors(result, CORNER)[0] < 0.15


def test_the_requests_camera_comes_before_exif(museum: Server, queries: list[View]) -> None:
    result = museum.locate(photo(queries[0].rgb, {}, {FOCAL_35MM: 60}), venue="museum")
    assert result["camera"]["source"] == "request"
    assert pose_errors(result, queries[0].world_from_camera)[0] < 0.02


def test_hostile_exif_is_ignored(museum: Server, queries: list[View]) -> None:
    rng = np.random.default_rng(3)
    for raw in (
        b"Exif\0\0" + rng.bytes(300),
        b"Exif\0\0MM\0*\xff\xff\xff\xff",
        b"Exif\0\0II*\0\x08\0\0\0\xff\xff",
    ):
        buffer = io.BytesIO()
        Image.fromarray(queries[0].rgb).save(buffer, "JPEG", quality=92, exif=raw)
        assert museum.locate(buffer.getvalue(), venue="museum")["located"]


@pytest.mark.parametrize("size", [(4000, 3000), (3000, 4000), (320, 240), (240, 320), (1280, 720)], ids=str)
@pytest.mark.parametrize("focal", [0.65, 0.95])
def test_other_sizes_and_fields_of_view(
    museum: Server, room: Room, size: tuple[int, int], focal: float
) -> None:
    width, height = size
    small = max(1, max(size) // 1000)
    camera = pinhole(width // small, height // small, focal * max(size) / small)
    rgb = Image.fromarray(room.view(CORNER, camera).rgb).resize(size, Image.Resampling.BICUBIC)
    given = json.dumps(
        {"model": "PINHOLE", "width": camera.width, "height": camera.height, "params": camera.params}
    )
    buffer = io.BytesIO()
    rgb.save(buffer, "JPEG", quality=90)
    result = post(museum, buffer.getvalue(), camera=given)
    assert result["located"], result
    assert (result["camera"]["width"], result["camera"]["height"]) == size
    assert pose_errors(result, CORNER)[0] < 0.05


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_gravity_turns_the_image_upright(museum: Server, queries: list[View], turns: int) -> None:
    for query in queries:
        rgb = np.ascontiguousarray(np.rot90(query.rgb, turns))
        held = query.world_from_camera @ camera_from_turned(turns)
        camera = pinhole(rgb.shape[1], rgb.shape[0], CAMERA.focal_px)
        params = ",".join(str(value) for value in camera.params)
        result = post(museum, photo(rgb, {}), camera=params, gravity=down_in_camera(held))
        assert result["located"], result
        assert result["camera"]["params"] == pytest.approx(camera.params)
        assert pose_errors(result, held)[0] < 0.02
        assert pose_errors(result, held)[1] < 0.5


@pytest.fixture(scope="module")
def upright_hall(museum: Server, views: list[View]) -> str:
    """A venue whose world's z axis is known to point up, since the build said where down is."""
    museum.add_venue("upright")
    built = museum.add_map(zipped(scan_files(views)), "upright", gravity=[0, 0, -1])
    assert built["report"]["placement"]["z_up"] is True
    return "upright"


def test_a_pose_that_gravity_contradicts_is_not_given(
    museum: Server, upright_hall: str, queries: list[View]
) -> None:
    query = queries[0]
    right = museum.locate(query.jpeg(), venue=upright_hall, gravity=down_in_camera(query.world_from_camera))
    assert (right["located"], right["gravity_checked"]) == (True, True)
    for pitch_deg, located in ((15.0, True), (27.0, False)):
        tilt = pose_at(0, 0, pitch_deg=pitch_deg).rotation.T @ pose_at(0, 0).rotation
        gravity = ",".join(str(v) for v in tilt @ query.world_from_camera.rotation.T @ [0, 0, -1.0])
        result = museum.locate(query.jpeg(), venue=upright_hall, gravity=gravity)
        assert (result["located"], result["gravity_checked"]) == (located, True)
        assert located or (result["reason"], result["pose"]) == ("ambiguous", None)


def test_gravity_is_not_checked_where_the_maps_down_is_not_known(
    leaning: Server, queries: list[View]
) -> None:
    result = leaning.locate(queries[0].jpeg(), venue="leaning", gravity="0,1,1")
    assert (result["located"], result["gravity_checked"]) == (True, False)
    assert leaning.locate(queries[0].jpeg(), venue="leaning")["gravity_checked"] is None


def test_gravity_along_the_axis_turns_nothing(leaning: Server, queries: list[View]) -> None:
    assert leaning.locate(queries[0].jpeg(), venue="leaning", gravity="0,0.1,9.8")["located"]


BAD = {
    "principal point": "262,262,340,119",
    "5 and 150 degrees": "20,20,159,119",
    "factor of two": "262,900,159,119",
    "aspect ratio": json.dumps(
        {"model": "PINHOLE", "width": 1920, "height": 1080, "params": [1500, 1500, 960, 540]}
    ),
    "EXIF orientation": json.dumps(
        {"model": "PINHOLE", "width": 240, "height": 320, "params": [262, 262, 119, 159]}
    ),
}


@pytest.mark.parametrize("words", BAD)
def test_a_camera_that_can_not_be_says_why(museum: Server, queries: list[View], words: str) -> None:
    answer = museum.post_image(queries[0].jpeg(), {"venue": "museum", "camera": BAD[words]})
    assert words in assert_problem(answer, 422, "invalid_camera")


def test_a_distorted_camera_is_turned_with_its_image(museum: Server, queries: list[View]) -> None:
    camera = Camera("OPENCV", 320, 240, (*CAMERA.params, 0.0, 0.0, 0.0, 0.0))
    text = ",".join(str(value) for value in camera.params)
    gravity = down_in_camera(queries[1].world_from_camera)
    result = museum.locate(queries[1].jpeg(), venue="museum", camera=text, gravity=gravity)
    assert result["camera"]["model"] == "OPENCV"
    assert result["camera"]["params"] == pytest.approx(camera.params)
