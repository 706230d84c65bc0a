"""What pages draw of a map version: points, keyframes, coverage, the view from above; and deleting a version."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
import pytest

from app.engine.maps.drawing.points import POINTS_MAGIC
from tests import scenes
from tests.server import QUICK, Server, assert_problem, running

NAMES = ("points", "keyframes", "keyframes/0/picture", "coverage?floor=g", "map.png")
# The plan lies a quarter turn from the world, and elsewhere.
PLAN_FROM_WORLD = np.array([[0, -1, 0, 10.0], [1, 0, 0, 20.0], [0, 0, 1, 0], [0, 0, 0, 1.0]])


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, scan_zip: bytes) -> Iterator[Server]:
    """A server with the scan's map in the venue `house`, on floor `g`; a floor `loose` is placed nowhere."""
    with running(tmp_path_factory.mktemp("views")) as server:
        server.add_venue("house")
        floor: dict[str, Any] = {"name": "Ground", "level": 0, "z_min_m": -0.5, "z_max_m": 3.0}
        loose = server.client.put("/venues/house/floors/loose", json={**floor, "level": 1})
        placed = server.client.put(
            "/venues/house/floors/g", json={**floor, "plan_from_world": PLAN_FROM_WORLD.tolist()}
        )
        assert (loose.status_code, placed.status_code) == (200, 200), placed.text
        server.add_map(scan_zip, "house", gravity=[0, 0, -1])
        yield server


def get(server: Server, name: str, version: int = 1, **query: Any) -> Any:
    answer = server.client.get(f"/venues/house/maps/{version}/{name}", params=query or None)
    assert answer.status_code == 200, answer.text
    return answer


def unpacked(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    assert data[:8] == POINTS_MAGIC
    count = int.from_bytes(data[8:12], "little")
    points = np.frombuffer(data, "<f4", 3 * count, 12).reshape(count, 3)
    rgb = np.frombuffer(data, np.uint8, 3 * count, 12 + 12 * count).reshape(count, 3)
    assert len(data) == 12 + 15 * count
    return points, rgb


def test_points_lie_on_the_walls_in_the_colours_of_the_pictures(
    server: Server, views: list[scenes.View]
) -> None:
    answer = get(server, "points")
    assert answer.headers["content-type"] == "application/octet-stream"
    points, rgb = unpacked(answer.content)
    assert len(points) > 500
    off_m = np.minimum(np.abs(points), np.abs(points - scenes.SIZE_M)).min(axis=1)
    assert np.median(off_m) < 0.02
    errors = []
    for view in views:
        in_camera = view.world_from_camera.inverse().apply(points.astype(float))
        ahead = np.flatnonzero(in_camera[:, 2] > 0.2)
        pixels = np.round(scenes.CAMERA.project(in_camera[ahead])).astype(int)
        inside = ((pixels >= 2) & (pixels < np.array([scenes.CAMERA.width, scenes.CAMERA.height]) - 2)).all(
            axis=1
        )
        u, v = pixels[inside].T
        blurred = cv2.blur(view.rgb, (3, 3))
        errors.append(np.abs(blurred[v, u].astype(int) - rgb[ahead[inside]]).mean(axis=1))
    assert np.median(np.concatenate(errors)) < 25


def test_points_are_thinned_evenly_to_what_was_asked_for(server: Server) -> None:
    everything, _ = unpacked(get(server, "points", max_points=1_000_000).content)
    few, _ = unpacked(get(server, "points", max_points=300).content)
    assert 100 < len(few) <= 300 < len(everything)
    # Every region of the map keeps a point.
    distances = np.linalg.norm(everything[::7, None] - few[None], axis=2).min(axis=1)
    assert np.quantile(distances, 0.99) < 0.6


def test_ply_holds_the_same_points(server: Server) -> None:
    answer = get(server, "points", format="ply", max_points=300)
    assert answer.headers["content-type"] == "application/ply"
    header, _, body = answer.content.partition(b"end_header\n")
    points, rgb = unpacked(get(server, "points", max_points=300).content)
    assert header.startswith(b"ply\nformat binary_little_endian 1.0\n")
    assert f"element vertex {len(points)}\n".encode() in header
    rows = np.frombuffer(body, np.dtype([("xyz", "<f4", 3), ("rgb", np.uint8, 3)]))
    assert np.array_equal(rows["xyz"], points)
    assert np.array_equal(rows["rgb"], rgb)


@pytest.mark.parametrize(
    "name", ["points", "points?format=ply", "keyframes/0/picture", "keyframes/0/picture?width=80"]
)
def test_what_the_client_has_is_not_sent_again(server: Server, name: str) -> None:
    path = f"/venues/house/maps/1/{name}"
    plain = server.client.get(path, headers={"Accept-Encoding": "identity"})
    packed = server.client.get(path, headers={"Accept-Encoding": "gzip"})
    assert plain.content == packed.content
    assert "content-encoding" not in plain.headers
    assert plain.headers["etag"] == packed.headers["etag"]
    again = server.client.get(path, headers={"If-None-Match": plain.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert server.client.get(path, headers={"If-None-Match": '"other"'}).content == plain.content


def test_keyframes_say_pose_time_and_place(server: Server, views: list[scenes.View]) -> None:
    keyframes = get(server, "keyframes").json()
    (version,) = server.client.get("/venues/house/maps").json()
    assert len(keyframes) == version["statistics"]["keyframes"] > 1
    for keyframe in keyframes:
        view = views[round(keyframe["time_s"] * 10)]
        world = view.world_from_camera.translation
        assert np.allclose([keyframe["pose"]["position"][axis] for axis in "xyz"], world, atol=0.02)
        assert keyframe["name"] == f"rgb/{keyframe['time_s']:.6f}.png"
        assert keyframe["floor"] == "g"
        place = PLAN_FROM_WORLD @ [*world, 1]
        assert np.allclose([keyframe["plan"]["x"], keyframe["plan"]["y"]], place[:2], atol=0.02)
        assert keyframe["picture"]
        assert keyframe["features"] > 50


def test_a_keyframes_picture_is_that_of_the_scan(server: Server, views: list[scenes.View]) -> None:
    whole = cv2.imdecode(
        np.frombuffer(get(server, "keyframes/0/picture").content, np.uint8), cv2.IMREAD_COLOR
    )
    assert np.abs(whole[..., ::-1].astype(int) - views[0].rgb).mean() < 12
    small = get(server, "keyframes/0/picture", width=80)
    assert small.headers["content-type"] == "image/jpeg"
    assert cv2.imdecode(np.frombuffer(small.content, np.uint8), cv2.IMREAD_COLOR).shape[1] == 80


def test_coverage_is_where_the_scan_looked(server: Server) -> None:
    body = get(server, "coverage", floor="g", cell_m=0.5).json()
    assert body["directions_deg"] == [0, 45, 90, 135, 180, 225, 270, 315]
    cells = {(cell["x"], cell["y"]): cell for cell in body["cells"]}
    # The scan turns from -40 to 77 degrees in the world, which the plan turns by 90.
    x, y = (PLAN_FROM_WORLD @ [1.9, 1.5, 1.5, 1])[:2]
    nearest = cells[min(cells, key=lambda at: np.hypot(at[0] - x, at[1] - y))]
    assert nearest["covered"][2]
    assert nearest["covered"][1]
    assert not any(nearest["covered"][5:])
    assert nearest["features"][2] > nearest["features"][6]
    reach = [np.hypot(cell["x"] - x, cell["y"] - y) for cell in body["cells"]]
    assert max(reach) < 3


def test_the_view_from_above_shows_points_and_keyframes(server: Server) -> None:
    for query in ({}, {"floor": "g"}):
        answer = get(server, "map.png", width=256, **query)
        assert answer.headers["content-type"] == "image/png"
        drawn = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
        assert max(drawn.shape) == 256
        assert ((drawn == [20, 90, 220]).all(axis=2)).sum() > 5
        assert ((drawn < 250).any(axis=2)).mean() > 0.01


def test_the_view_from_above_lies_on_the_plan_image(server: Server) -> None:
    try:
        image = scenes.encode(np.full((200, 300, 3), 90, np.uint8), ".png")
        form = {"meters_per_pixel": "0.05", "origin_px": "-100,500"}
        put = server.client.put("/venues/house/floors/g/plan", data=form, files={"image": image})
        assert put.status_code == 200, put.text
        data = get(server, "map.png", floor="g", width=600).content
        drawn = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
        assert drawn.shape == (400, 600, 3)
        pale = drawn[0, 0]
        assert (pale > 150).all()
        keyframe = get(server, "keyframes").json()[0]["plan"]
        u = 2 * (-100 + keyframe["x"] / 0.05)
        v = 2 * (500 - keyframe["y"] / 0.05)
        assert (
            (drawn[round(v) - 1 : round(v) + 3, round(u) - 1 : round(u) + 3] == [20, 90, 220])
            .all(axis=2)
            .any()
        )
    finally:
        floor = server.client.get("/venues/house/floors/g").json()
        server.client.delete("/venues/house/floors/g")
        kept = {name: floor[name] for name in ("name", "level", "z_min_m", "z_max_m", "plan_from_world")}
        assert server.client.put("/venues/house/floors/g", json=kept).status_code == 200


@pytest.mark.parametrize("name", NAMES)
def test_what_is_not_there_is_a_404(server: Server, name: str) -> None:
    for path in (f"/venues/none/maps/1/{name}", f"/venues/house/maps/99/{name}"):
        assert_problem(server.client.get(path), 404, "not_found")


def test_a_floor_or_keyframe_that_is_not_there_is_a_404(server: Server) -> None:
    for name in ("coverage?floor=none", "map.png?floor=none", "keyframes/9999/picture"):
        assert_problem(server.client.get(f"/venues/house/maps/1/{name}"), 404, "not_found")


def test_a_floor_without_a_place_in_the_world_is_a_409(server: Server) -> None:
    for name in ("coverage?floor=loose", "map.png?floor=loose"):
        detail = assert_problem(server.client.get(f"/venues/house/maps/1/{name}"), 409, "conflict")
        assert "plan_from_world" in detail


def test_a_map_of_unknown_up_has_no_place_on_a_floor(leaning: Server) -> None:
    assert leaning.client.get("/venues/leaning/maps/1/map.png").status_code == 200
    assert all(k["plan"] is None for k in leaning.client.get("/venues/leaning/maps/1/keyframes").json())


@pytest.mark.parametrize(
    "name",
    [
        "points?max_points=0",
        "points?max_points=999999999999",
        "points?max_points=nan",
        "points?format=las",
        "points?formt=ply",
        "coverage",
        "coverage?floor=g&cell_m=0",
        "coverage?floor=g&cell_m=nan",
        "coverage?floor=g&cell_m=1e9",
        "coverage?floor=../g",
        "coverage?floor=%00",
        "map.png?width=0",
        "map.png?width=1000000",
        "map.png?floor='; drop table floors",
        "keyframes/-1/picture",
        "keyframes/99999999999999999999/picture",
        "keyframes/0/picture?width=1",
        "keyframes/0/picture?width=1e400",
    ],
)
def test_hostile_values_are_refused(server: Server, name: str) -> None:
    with server.unchanged():
        assert_problem(server.client.get(f"/venues/house/maps/1/{name}"), 422, "invalid_request")


@pytest.mark.parametrize("version", ["0", "-1", "1.5", "99999999999999999999", "%2e%2e", "one"])
def test_hostile_versions_are_refused(server: Server, version: str) -> None:
    for name in NAMES:
        assert server.client.get(f"/venues/house/maps/{version}/{name}").status_code in (404, 422)


def test_every_view_asks_for_the_key(tmp_path_factory: pytest.TempPathFactory) -> None:
    with running(tmp_path_factory.mktemp("locked"), run_worker=False, admin_key="secret") as locked:
        for name in NAMES:
            assert_problem(locked.client.get(f"/venues/house/maps/1/{name}"), 401, "unauthenticated")
        assert_problem(locked.client.delete("/venues/house/maps/1"), 401, "unauthenticated")


def test_a_map_without_pictures_is_grey(server: Server, views: list[scenes.View]) -> None:
    server.add_venue("plain")
    server.add_map(scenes.zipped(scenes.scan_files(views[:4])), "plain", store_images=False, **QUICK)
    points, rgb = unpacked(server.client.get("/venues/plain/maps/1/points").content)
    assert len(points) > 500
    assert (rgb == 128).all()
    keyframes = server.client.get("/venues/plain/maps/1/keyframes").json()
    assert not any(keyframe["picture"] for keyframe in keyframes)
    assert_problem(server.client.get("/venues/plain/maps/1/keyframes/0/picture"), 404, "not_found")


def test_a_version_is_deleted_but_never_the_one_that_serves(server: Server, views: list[scenes.View]) -> None:
    server.add_venue("twice")
    scan = scenes.zipped(scenes.scan_files(views[:4]))
    server.add_maps("twice", (scan, QUICK), (scan, QUICK))
    assert_problem(server.client.delete("/venues/twice/maps/2"), 409, "conflict")
    assert server.client.delete("/venues/twice/maps/1").status_code == 204
    assert_problem(server.client.delete("/venues/twice/maps/1"), 404, "not_found")
    assert_problem(server.client.get("/venues/twice/maps/1/points"), 404, "not_found")
    assert [each["version"] for each in server.client.get("/venues/twice/maps").json()] == [2]
    # A number is never given again, even when the newest version is deleted.
    assert server.build(scan, "twice", **QUICK)["map_version"] == 3
    assert server.client.post("/venues/twice/maps/2/activate").status_code == 200
    assert server.client.delete("/venues/twice/maps/3").status_code == 204
    assert server.build(scan, "twice", **QUICK)["map_version"] == 4


def test_a_picture_that_the_store_has_lost_leaves_its_points_grey(server: Server, scan_zip: bytes) -> None:
    server.add_venue("lost")
    server.add_map(scan_zip, "lost", gravity=[0, 0, -1])
    blobs, aside = server.data_dir / "blobs", server.data_dir / "aside"
    pictures = [
        path for path in blobs.rglob("*") if path.is_file() and path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    ]
    aside.mkdir()
    try:
        for k, path in enumerate(pictures):
            shutil.move(path, aside / str(k))
        _, rgb = unpacked(server.client.get("/venues/lost/maps/1/points?max_points=777").content)
        assert (rgb == 128).all()
    finally:
        for k, path in enumerate(pictures):
            shutil.move(aside / str(k), path)
        aside.rmdir()
