"""Builds over HTTP: from an archive to a map that serves; versions, extension, progress and cancellation."""

from __future__ import annotations

import io
import itertools
import json
import tarfile
from collections.abc import Iterator

import numpy as np
import pytest

from app.geometry.se3 import Pose, rotation_from_vector
from tests.scenes import CAMERA_TEXT, Room, View, pose_at, scan_files, walk, zipped
from tests.server import QUICK, Server, assert_problem, assert_sentence, running

# The walk in two halves that share half of what they see.
HALF = 9


@pytest.fixture(scope="module")
def first_half(views: list[View]) -> bytes:
    """The scan's first frames."""
    return zipped(scan_files(views[:HALF]))


@pytest.fixture(scope="module")
def small_scan(views: list[View]) -> bytes:
    """A scan that is built in a moment."""
    return zipped(scan_files(views[:4]))


@pytest.fixture(scope="module")
def second_half(room: Room) -> list[View]:
    """The rest of the walk, walked again a few centimetres aside."""
    poses = [
        Pose(pose.rotation, np.add(pose.translation, [0.03, -0.04, 0.02]))
        for pose in (*walk()[5:], pose_at(2.6, 1.9, 1.4, 92.0, -2.0), pose_at(2.6, 1.9, 1.42, 101.0, 1.0))
    ]
    return [room.view(pose) for pose in poses]


@pytest.fixture
def idle(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server whose builds stay in the queue, with the venue `v`."""
    with running(tmp_path_factory.mktemp("idle"), run_worker=False) as server:
        server.add_venue("v")
        yield server


def test_a_build_reports_what_it_did(museum: Server, scan_zip: bytes) -> None:
    museum.add_venue("reported")
    build = museum.build(scan_zip, "reported", format="tum", keyframes={"rule": "pose"})
    assert (build["state"], build["error"], build["map_version"], build["attempts"]) == (
        "succeeded",
        None,
        1,
        1,
    )
    assert build["created_at"] <= build["started_at"] <= build["finished_at"]
    report = build["report"]
    assert report["frames"] == 14
    assert 5 < report["keyframes"] <= 14
    assert report["features"] > 100 * report["keyframes"]
    assert np.allclose(report["world_from_scan"], np.eye(4))
    assert report["self_check"]["located"] > 0
    (version,) = museum.client.get("/venues/reported/maps").json()
    assert (version["version"], version["active"], version["build"]) == (1, True, build["build"])
    assert version["statistics"]["keyframes"] == report["keyframes"]
    assert museum.client.get("/venues/reported").json()["map_version"] == 1
    builds = museum.client.get("/database/builds", params={"venue": "reported"}).json()
    assert builds == [build]
    # Scratch is empty and the archive gone: what stays is the map and its pictures.
    assert not [name for name in museum.files() if name.startswith("scratch")]


def test_a_map_that_tests_copy_is_the_one_that_a_worker_builds(museum: Server, small_scan: bytes) -> None:
    built = museum.build(small_scan, museum.add_venue("built"), second_features=False, **QUICK)
    copied = museum.add_map(small_scan, museum.add_venue("copied"), **QUICK)
    assert {**built["report"], "seconds": None} == {**copied["report"], "seconds": None}
    assert (built["state"], built["map_version"]) == (copied["state"], copied["map_version"])
    for name in ("keyframes", "points", "keyframes/0/picture"):
        answers = [museum.client.get(f"/venues/{venue}/maps/1/{name}") for venue in ("built", "copied")]
        assert [answer.status_code for answer in answers] == [200, 200]
        assert answers[0].content == answers[1].content, name


@pytest.mark.parametrize("mode", ["w", "w:gz"])
def test_a_tar_with_a_folder_is_as_good_as_a_zip(museum: Server, views: list[View], mode: str) -> None:
    venue = museum.add_venue(f"tar-{len(mode)}")
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode=mode) as archive:  # type: ignore[call-overload]
        for name, data in scan_files(views[:4]).items():
            member = tarfile.TarInfo(f"my scan/{name}")
            member.size = len(data)
            archive.addfile(member, io.BytesIO(data))
    assert museum.build(buffer.getvalue(), venue)["state"] == "succeeded"


@pytest.mark.parametrize("features", ["orb", "akaze", "xfeat"])
def test_every_kind_of_features_locates(
    museum: Server, first_half: bytes, queries: list[View], features: str
) -> None:
    venue = museum.add_venue(f"with-{features}")
    build = museum.build(first_half, venue, features=features, keyframes={"rule": "interval", "every": 2})
    assert build["state"] == "succeeded", build["error"]
    assert build["report"]["feature_method"] == features
    assert build["report"]["keyframes"] <= 5
    result = museum.locate(queries[1].jpeg(), venue=venue)
    found = result["pose"]["position"]
    truth = queries[1].world_from_camera.translation
    assert np.allclose([found["x"], found["y"], found["z"]], truth, atol=0.05)


def test_gravity_turns_the_scan_upright(museum: Server, views: list[View], queries: list[View]) -> None:
    venue = museum.add_venue("tilted")
    tilt = Pose(rotation_from_vector([0.4, -1.1, 0.3]), [3.0, -2.0, 7.0])
    down = tilt.rotation @ [0.0, 0.0, -1.0]
    build = museum.build(zipped(scan_files(views[:5], tilt)), venue, gravity=down.tolist())
    assert build["report"]["placement"]["source"] == "gravity"
    world_from_scan = np.array(build["report"]["world_from_scan"])
    assert np.allclose(world_from_scan[:3, :3] @ down, [0, 0, -1], atol=1e-6)
    pose = museum.locate(queries[0].jpeg(), venue=venue)["pose"]
    q = pose["quaternion"]
    found = Pose.from_quaternion([0, 0, 0], [q["x"], q["y"], q["z"], q["w"]])
    # How the camera is held against the vertical no longer depends on the scan's frame.
    assert np.allclose(found.rotation[2], queries[0].world_from_camera.rotation[2], atol=0.01)


def test_an_earlier_version_can_be_brought_back(
    museum: Server, small_scan: bytes, queries: list[View]
) -> None:
    venue = museum.add_venue("versions")
    image, x = queries[0].jpeg(), queries[0].world_from_camera.translation[0]
    assert museum.build(small_scan, venue, **QUICK)["map_version"] == 1
    moved = np.eye(4)
    moved[0, 3] = 10.0
    assert museum.build(small_scan, venue, world_from_scan=moved.tolist())["map_version"] == 2

    def serving() -> tuple[int, float]:
        result = museum.locate(image, venue=venue)
        return result["map_version"], result["pose"]["position"]["x"]

    assert serving() == (2, pytest.approx(x + 10, abs=0.02))
    answer = museum.client.post(f"/venues/{venue}/maps/1/activate")
    assert (answer.status_code, answer.json()["active"]) == (200, True)
    assert serving() == (1, pytest.approx(x, abs=0.02))
    versions = museum.client.get(f"/venues/{venue}/maps").json()
    assert [(v["version"], v["active"]) for v in versions] == [(2, False), (1, True)]
    museum.client.post(f"/venues/{venue}/maps/2/activate")
    assert serving() == (2, pytest.approx(x + 10, abs=0.02))
    # A later build counts on from the newest version, whichever serves.
    museum.client.post(f"/venues/{venue}/maps/1/activate")
    assert museum.build(small_scan, venue, **QUICK)["map_version"] == 3


def test_a_map_is_extended_by_a_scan_that_is_placed(
    museum: Server, first_half: bytes, second_half: list[View], room: Room
) -> None:
    venue = museum.add_venue("extended")
    first = museum.add_map(first_half, venue)
    query = room.view(pose_at(2.6, 1.9, 1.43, 112.0))
    assert not museum.locate(query.jpeg(), venue=venue)["located"]
    second = museum.build(
        zipped(scan_files(second_half)), venue, mode="extend", world_from_scan=np.eye(4).tolist()
    )
    assert second["state"] == "succeeded", second["error"]
    assert second["report"]["placement"]["source"] == "given"
    assert second["report"]["map_keyframes"] == first["report"]["keyframes"] + second["report"]["keyframes"]
    for pose in (query.world_from_camera, pose_at(1.5, 1.32, 1.42, -33.0)):
        found = museum.locate(room.view(pose).jpeg(), venue=venue)["pose"]["position"]
        assert np.allclose([found["x"], found["y"], found["z"]], pose.translation, atol=0.03)


def test_a_map_is_extended_by_a_scan_that_finds_its_place(
    museum: Server, first_half: bytes, second_half: list[View], room: Room
) -> None:
    venue = museum.add_venue("registered")
    museum.add_map(first_half, venue)
    scan_from_world = Pose(rotation_from_vector([0.0, 0.0, 2.1]), [5.0, 6.0, -0.7])
    build = museum.build(zipped(scan_files(second_half, scan_from_world)), venue, mode="extend")
    assert build["state"] == "succeeded", build["error"]
    placement = build["report"]["placement"]
    assert placement["source"] == "registered"
    assert placement["agreeing"] >= 5
    truth = scan_from_world.inverse().matrix
    assert np.allclose(build["report"]["world_from_scan"], truth, atol=0.02)
    query = pose_at(2.6, 1.9, 1.43, 112.0)
    found = museum.locate(room.view(query).jpeg(), venue=venue)["pose"]["position"]
    assert np.allclose([found["x"], found["y"], found["z"]], query.translation, atol=0.05)


def test_a_scan_of_another_place_does_not_extend_a_map(
    museum: Server, first_half: bytes, foreign_room: Room
) -> None:
    venue = museum.add_venue("unextended")
    museum.add_map(first_half, venue)
    elsewhere = zipped(scan_files([foreign_room.view(pose) for pose in walk()]))
    with museum.unchanged("builds"):
        build = museum.build(elsewhere, venue, mode="extend")
    assert (build["state"], build["error_code"]) == ("failed", "invalid_scan")
    assert_sentence(build["error"])


def test_a_build_that_fails_when_it_has_stored_its_pictures_removes_them(
    museum: Server, small_scan: bytes, second_half: list[View]
) -> None:
    venue = museum.add_venue("orb-first")
    museum.add_map(small_scan, venue, features="orb")
    with museum.unchanged("builds"):
        options = {"mode": "extend", "features": "sift", "world_from_scan": np.eye(4).tolist()}
        build = museum.build(zipped(scan_files(second_half[:4])), venue, **options)
    assert (build["state"], build["error_code"]) == ("failed", "invalid_input")
    assert "orb" in build["error"]


def test_events_follow_a_build_to_its_end(museum: Server, small_scan: bytes) -> None:
    venue = museum.add_venue("watched")
    submitted = museum.submit(small_scan, venue).json()
    assert submitted["status_url"] == f"/database/builds/{submitted['build']}"
    with museum.client.stream("GET", submitted["events_url"]) as answer:
        assert answer.headers["content-type"].startswith("text/event-stream")
        assert answer.headers["x-request-id"]
        lines = [line.removeprefix("data: ") for line in answer.iter_lines() if line.startswith("data:")]
    bodies = [json.loads(line) for line in lines]
    assert bodies[-1] == museum.status(submitted["build"])
    assert bodies[-1]["state"] == "succeeded"
    assert all(body["state"] in ("queued", "running") for body in bodies[:-1])
    assert all(a != b for a, b in itertools.pairwise(bodies))


def test_events_of_an_ended_build_are_one(museum: Server) -> None:
    build = museum.client.get("/database/builds", params={"venue": "museum"}).json()[0]
    text = museum.client.get(f"/database/builds/{build['build']}/events").text
    assert [json.loads(line[5:]) for line in text.splitlines() if line.startswith("data:")] == [build]


def test_a_queued_build_is_cancelled_at_once(idle: Server, scan_zip: bytes) -> None:
    with idle.unchanged("builds"):
        build = idle.submit(scan_zip, "v").json()["build"]
        assert idle.status(build)["state"] == "queued"
        answer = idle.client.delete(f"/database/builds/{build}")
        assert answer.status_code == 202
        assert answer.json()["state"] == "cancelled"
    assert_problem(idle.client.delete(f"/database/builds/{build}"), 409, "conflict")


def test_the_archive_of_two_builds_stays_until_both_have_ended(idle: Server, scan_zip: bytes) -> None:
    before = idle.files()
    builds = [idle.submit(scan_zip, "v").json()["build"] for _ in range(2)]
    (archive,) = idle.files() - before
    idle.client.delete(f"/database/builds/{builds[0]}")
    assert archive in idle.files()
    idle.client.delete(f"/database/builds/{builds[1]}")
    assert archive not in idle.files()


def test_an_ended_build_can_not_be_cancelled(museum: Server) -> None:
    build = museum.client.get("/venues/museum/maps").json()[-1]["build"]
    with museum.unchanged():
        assert "succeeded" in assert_problem(
            museum.client.delete(f"/database/builds/{build}"), 409, "conflict"
        )


def test_a_venue_takes_its_builds_maps_and_floors_along(museum: Server, small_scan: bytes) -> None:
    with museum.unchanged_rows():
        venue = museum.add_venue("gone")
        build = museum.build(small_scan, venue, **QUICK)["build"]
        floor = {"name": "0", "level": 0, "z_min_m": 0, "z_max_m": 3}
        assert museum.client.put(f"/venues/{venue}/floors/0", json=floor).status_code == 200
        assert museum.client.delete(f"/venues/{venue}").status_code == 204
    assert_problem(museum.client.get(f"/database/builds/{build}"), 404, "not_found")
    assert_problem(museum.client.get(f"/venues/{venue}/maps"), 404, "not_found")


def test_camera_text_and_list_mean_the_same(idle: Server, scan_zip: bytes) -> None:
    for camera in (CAMERA_TEXT, [float(v) for v in CAMERA_TEXT.split(",")]):
        assert idle.submit(scan_zip, "v", {"camera": camera}).status_code == 202
