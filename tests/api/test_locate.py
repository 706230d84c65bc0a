"""POST /locate: where the camera is, on which floor and where on its plan, or why that can't be said."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest

from tests.scenes import CAMERA, CAMERA_TEXT, Room, View, encode, pose_at
from tests.server import Server, assert_problem, pose_errors

PLAN_YAW_DEG, PLAN_SHIFT = 30.0, (2.0, 1.0)
METERS_PER_PIXEL, ORIGIN_PX = 0.02, (50.0, 250.0)


def plan_from_world() -> list[list[float]]:
    c, s = np.cos(np.radians(PLAN_YAW_DEG)), np.sin(np.radians(PLAN_YAW_DEG))
    return [[c, -s, 0, PLAN_SHIFT[0]], [s, c, 0, PLAN_SHIFT[1]], [0, 0, 1, 0], [0, 0, 0, 1]]


def put_floor(server: Server, venue: str, floor: str, z_min_m: float, z_max_m: float, **more: object) -> None:
    body = {"name": floor, "level": 0, "z_min_m": z_min_m, "z_max_m": z_max_m, **more}
    answer = server.client.put(f"/venues/{venue}/floors/{floor}", json=body)
    assert answer.status_code == 200, answer.text


@pytest.fixture(scope="module")
def hall(museum: Server, scan_zip: bytes) -> str:
    """A venue with a map whose floors the tests may change."""
    museum.add_venue("hall")
    museum.add_map(scan_zip, "hall", gravity=[0, 0, -1])
    return "hall"


def test_a_photo_gets_its_pose(museum: Server, queries: list[View]) -> None:
    for query in queries:
        result = museum.locate(query.jpeg(), venue="museum")
        assert result["located"] is True
        assert result["reason"] is None
        error_m, error_deg = pose_errors(result, query.world_from_camera)
        assert error_m < 0.02
        assert error_deg < 0.5
        assert (result["venue"], result["map_version"], result["method"]) == ("museum", 1, "rgbd")
        assert 0 < result["accuracy"]["position_m"] < 0.2
        assert result["confidence"] >= 0.85
        assert result["matches"] >= result["inliers"] >= 20
        assert sum(vote["inliers"] for vote in result["keyframes"]) >= result["inliers"]
        assert result["camera"]["source"] == "request"
        assert set(result["timings_ms"]) == {"decode", "describe", "retrieve", "match", "pose", "total"}
        # Without a floor there is no plan.
        assert result["floor"] is None
        assert result["plan"] is None


def test_a_pose_that_is_less_sure_than_wanted_is_refused(museum: Server, queries: list[View]) -> None:
    sent = queries[0].jpeg()
    usual = museum.locate(sent, venue="museum")
    risk = 1 - usual["confidence"]
    wanted = museum.locate(sent, venue="museum", max_risk=str(1.05 * risk))
    assert wanted["pose"] == usual["pose"]
    refused = museum.locate(sent, venue="museum", max_risk=str(0.95 * risk))
    assert (refused["located"], refused["reason"], refused["pose"]) == (False, "too_few_inliers", None)
    assert refused["confidence"] == 0
    assert refused["hints"] == ["look_elsewhere"]


@pytest.mark.parametrize("value", ["0", "-0.1", "1.01", "nan", "much"])
def test_a_risk_is_above_0_and_at_most_1(museum: Server, queries: list[View], value: str) -> None:
    files = {"image": ("query.jpg", queries[0].jpeg(), "image/jpeg")}
    answer = museum.client.post("/locate", files=files, data={"venue": "museum", "max_risk": value})
    assert_problem(answer, 422)
    assert "max_risk" in answer.text


def test_the_camera_as_json_is_scaled_to_the_image(museum: Server, queries: list[View]) -> None:
    fx, fy, cx, cy = CAMERA.params
    double = [2 * fx, 2 * fy, 2 * cx + 0.5, 2 * cy + 0.5]
    camera = json.dumps({"model": "PINHOLE", "width": 640, "height": 480, "params": double})
    result = museum.locate(queries[0].jpeg(), venue="museum", camera=camera)
    assert result["camera"]["params"] == pytest.approx(CAMERA.params)
    assert pose_errors(result, queries[0].world_from_camera)[0] < 0.02


def test_without_a_camera_the_focal_length_is_found(museum: Server, room: Room) -> None:
    # A corner: before one flat wall alone, distance and focal length can't be told apart.
    query = room.view(pose_at(1.7, 1.4, 1.45, 28.0, 2.0))
    answer = museum.post_image(query.jpeg(), {"venue": "museum"})
    result = answer.json()
    assert result["located"], result
    assert result["camera"]["source"] == "search"
    assert result["camera"]["params"][0] == pytest.approx(CAMERA.params[0], rel=0.05)
    assert pose_errors(result, query.world_from_camera)[0] < 0.15


def test_the_point_on_the_plan(museum: Server, hall: str, queries: list[View]) -> None:
    put_floor(museum, hall, "ground", 0.0, 2.6, plan_from_world=plan_from_world())
    drawing = encode(np.full((300, 400, 3), 255, np.uint8), ".png")
    form = {"meters_per_pixel": str(METERS_PER_PIXEL), "origin_px": "50,250"}
    answer = museum.client.put(f"/venues/{hall}/floors/ground/plan", data=form, files={"image": drawing})
    assert answer.status_code == 200, answer.text
    yaws = (-40 + 9 * i + 4.0 for i in (1, 4, 7, 10))
    for query, yaw_deg in zip(queries, yaws, strict=True):
        result = museum.locate(query.png(), venue=hall)
        x, y, _ = query.world_from_camera.translation
        c, s = np.cos(np.radians(PLAN_YAW_DEG)), np.sin(np.radians(PLAN_YAW_DEG))
        truth = PLAN_SHIFT[0] + c * x - s * y, PLAN_SHIFT[1] + s * x + c * y
        plan = result["plan"]
        assert result["floor"] == "ground"
        assert (plan["x"], plan["y"]) == pytest.approx(truth, abs=0.02)
        assert plan["heading_deg"] == pytest.approx((yaw_deg + PLAN_YAW_DEG) % 360, abs=0.5)
        assert plan["u_px"] == pytest.approx(ORIGIN_PX[0] + truth[0] / METERS_PER_PIXEL, abs=1)
        assert plan["v_px"] == pytest.approx(ORIGIN_PX[1] - truth[1] / METERS_PER_PIXEL, abs=1)


def test_the_floor_is_the_one_at_the_cameras_height(museum: Server, hall: str, queries: list[View]) -> None:
    image = queries[0].jpeg()
    # The camera is 1.45 m above the room's floor.
    for low, high, expected in (
        ((0, 1), (1.3, 3), "high"),
        ((0, 2), (2.5, 5), "low"),
        ((0, 1.2), (9, 12), "low"),
    ):
        put_floor(museum, hall, "low", *low, plan_from_world=plan_from_world())
        put_floor(museum, hall, "high", *high)
        museum.client.delete(f"/venues/{hall}/floors/ground")
        result = museum.locate(image, venue=hall)
        assert result["floor"] == expected
        # A floor without plan_from_world has no point on its plan.
        assert (result["plan"] is None) == (expected == "high")


def test_without_a_known_up_there_is_a_pose_and_no_plan(
    museum: Server, scan_zip: bytes, queries: list[View]
) -> None:
    venue = museum.add_venue("leaning")
    build = museum.add_map(scan_zip, venue)
    assert build["report"]["placement"]["z_up"] is False
    put_floor(museum, venue, "ground", 0.0, 2.6, plan_from_world=plan_from_world())
    result = museum.locate(queries[0].png(), venue=venue)
    assert result["pose"] is not None
    assert (result["plan"], result["plan_reason"], result["floor"]) == (None, "up_unknown", "ground")


def test_a_camera_on_no_floor_is_outside(museum: Server, hall: str, queries: list[View]) -> None:
    for floor in ("low", "high", "ground"):
        museum.client.delete(f"/venues/{hall}/floors/{floor}")
    put_floor(museum, hall, "attic", 10.0, 12.0)
    result = museum.locate(queries[0].jpeg(), venue=hall)
    assert (result["located"], result["reason"], result["pose"]) == (False, "outside_venue", None)
    assert result["accuracy"] is None
    assert result["confidence"] == 0
    museum.client.delete(f"/venues/{hall}/floors/attic")


def test_a_prior_narrows_the_search_and_a_wrong_one_does_not_mislead(
    museum: Server, queries: list[View]
) -> None:
    x, y, z = (float(value) for value in queries[0].world_from_camera.translation)
    right = json.dumps({"position": {"x": x, "y": y, "z": z}, "radius_m": 1.0})
    result = museum.locate(queries[0].jpeg(), venue="museum", prior=right)
    assert result["located"]
    assert result["narrowed"] is True
    wrong = json.dumps({"position": {"x": x + 80, "y": y, "z": z}, "radius_m": 1.0})
    result = museum.locate(queries[0].jpeg(), venue="museum", prior=wrong)
    assert result["narrowed"] is False
    assert pose_errors(result, queries[0].world_from_camera)[0] < 0.02


def test_a_floor_narrows_the_search(museum: Server, hall: str, queries: list[View]) -> None:
    put_floor(museum, hall, "this", 0.0, 2.6)
    put_floor(museum, hall, "above", 3.0, 5.0)
    image = queries[0].jpeg()
    assert museum.locate(image, venue=hall, floor="this")["narrowed"] is True
    other = museum.locate(image, venue=hall, floor="above")
    assert (other["floor"], other["narrowed"]) == ("this", False)
    for floor in ("this", "above"):
        museum.client.delete(f"/venues/{hall}/floors/{floor}")


def test_an_image_turned_by_exif_is_turned_upright(museum: Server, queries: list[View]) -> None:
    import io

    from PIL import Image

    turned = Image.fromarray(queries[1].rgb).transpose(Image.Transpose.ROTATE_90)
    exif = Image.Exif()
    exif[0x0112] = 6
    buffer = io.BytesIO()
    turned.save(buffer, "JPEG", quality=92, exif=exif)
    result = museum.locate(buffer.getvalue(), venue="museum")
    assert pose_errors(result, queries[1].world_from_camera)[0] < 0.02


@pytest.mark.parametrize("value", [0, 255, 128])
def test_an_image_without_anything_in_it_is_poor(museum: Server, value: int) -> None:
    image = encode(np.full((240, 320, 3), value, np.uint8), ".png")
    result = museum.locate(image, venue="museum")
    assert (result["located"], result["reason"], result["pose"]) == (False, "poor_image", None)
    light = {0: "more_light", 255: "less_light", 128: "step_back"}
    assert result["hints"][0] == light[value]
    assert result["hints"][-1] == "look_elsewhere"


def test_another_place_is_not_located(museum: Server, foreign_room: Room, queries: list[View]) -> None:
    for query in queries:
        image = foreign_room.view(query.world_from_camera).jpeg()
        for camera in ({"camera": CAMERA_TEXT}, {}):
            result = museum.post_image(image, {"venue": "museum", **camera}).json()
            assert result["located"] is False
            assert result["reason"] in ("no_match", "too_few_inliers", "ambiguous")
            assert result["pose"] is None


def test_noise_is_not_located(museum: Server) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (240, 320, 3), dtype=np.uint8)
    result = museum.locate(encode(noise, ".png"), venue="museum")
    assert result["located"] is False
    assert result["reason"] in ("no_match", "too_few_inliers")


def test_a_mirrored_picture_is_not_located(museum: Server, queries: list[View]) -> None:
    mirrored = cv2.flip(queries[0].rgb[..., ::-1], 1)
    assert museum.locate(encode(mirrored, ".png"), venue="museum")["located"] is False


def test_many_at_once_get_the_same_answers(museum: Server, queries: list[View]) -> None:
    images = [query.jpeg() for query in queries] * 4
    with ThreadPoolExecutor(8) as pool:
        results = list(pool.map(lambda image: museum.locate(image, venue="museum"), images))
    for result, query in zip(results, queries * 4, strict=True):
        assert pose_errors(result, query.world_from_camera)[0] < 0.02
    assert all(a["pose"] == b["pose"] for a, b in zip(results[:4], results[4:8], strict=True))


def test_one_venue_needs_no_name_and_two_do(empty: Server, queries: list[View]) -> None:
    image = queries[0].jpeg()
    assert "venue" in assert_problem(empty.post_image(image, {}), 422, "invalid_input")
    empty.add_venue("one")
    result = empty.locate(image)
    assert (result["venue"], result["reason"], result["map_version"]) == ("one", "no_map", None)
    assert result["located"] is False
    empty.add_venue("two")
    assert "venue" in assert_problem(empty.post_image(image, {"camera": CAMERA_TEXT}), 422, "invalid_input")
