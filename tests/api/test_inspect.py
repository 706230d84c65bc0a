"""`POST /database/inspect`: what a scan holds, the same refusals as a build, and nothing that stays."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from dataclasses import replace

import httpx
import pytest

from tests.scenes import CAMERA_TEXT, DEPTH_SCALE, View, scan_files, zipped
from tests.server import Server, assert_problem, running


def post(server: Server, archive: bytes, options: object = None) -> httpx.Response:
    return server.client.post(
        "/database/inspect",
        data={"options": json.dumps(options or {"camera": CAMERA_TEXT})},
        files={"archive": ("scan.zip", archive)},
    )


def test_a_scan_is_described(museum: Server, scan_zip: bytes) -> None:
    with museum.unchanged():
        answer = post(museum, scan_zip)
    assert answer.status_code == 200, answer.text
    body = answer.json()
    assert body["format"] == "tum"
    assert body["recognised"] == [{"format": "tum", "folder": "", "missing": []}]
    assert body["frames"] > 5
    assert body["sensors"]["color"]["model"] == "PINHOLE"
    low, middle, high = body["sensors"]["depth"]["percentiles_m"]
    assert 0 < low < middle < high < 30
    assert body["trajectory"]["path_m"] > 0
    assert body["examination"]["verdict"] in ("confirmed", "doubtful", "unknown")
    assert body["loops"]["found"] <= body["loops"]["compared"] <= 24
    assert body["build"]["would"] == "build"
    assert 0 < body["build"]["keyframes"] <= body["frames"]
    circles = ET.fromstring(body["path_svg"]).findall("{http://www.w3.org/2000/svg}circle")
    assert len(circles) == body["build"]["keyframes"] + 2


def test_an_upload_is_described_and_stays(museum: Server, scan_zip: bytes) -> None:
    with museum.unchanged(), museum.uploaded(scan_zip) as upload:
        form = {"options": json.dumps({"camera": CAMERA_TEXT}), "upload": upload}
        answer = museum.client.post("/database/inspect", data=form)
    assert answer.status_code == 200, answer.text
    assert answer.json()["build"]["would"] == "build"


def test_a_build_takes_the_announced_keyframes_that_are_sharp(museum: Server, scan_zip: bytes) -> None:
    announced = post(museum, scan_zip).json()["build"]["keyframes"]
    museum.add_venue("annex-inspected")
    report = museum.add_map(scan_zip, "annex-inspected")["report"]
    unusable = sum(report["discarded"].values()) - len(report["replaced"])
    assert report["keyframes"] == announced - unusable


def test_a_scan_that_a_build_refuses_is_refused(museum: Server, views: list[View], scan_zip: bytes) -> None:
    with museum.unchanged():
        files = scan_files(views[:8])
        files.pop("groundtruth.txt")
        assert_problem(post(museum, zipped(files)), 422, "invalid_scan")
        assert_problem(post(museum, scan_zip[: len(scan_zip) // 2]), 422, "invalid_scan")
        assert_problem(post(museum, b""), 422, "invalid_scan")


def without_poses(views: list[View], colour_alone: bool = False) -> bytes:
    files = scan_files(views)
    files.pop("groundtruth.txt")
    return zipped({name: data for name, data in files.items() if name.startswith("rgb/") or not colour_alone})


def test_depth_images_without_poses_are_described(museum: Server, views: list[View]) -> None:
    options = {"camera": CAMERA_TEXT, "poses": "estimate"}
    archive = without_poses(views)
    with museum.unchanged():
        answer = post(museum, archive, options)
        doubtful = post(museum, archive, {**options, "depth_scale": 5 * DEPTH_SCALE})
    assert answer.status_code == 200, answer.text
    body = answer.json()
    assert (body["format"], body["frames"]) == ("tum", len(views))
    assert 8 <= body["build"]["pictures"] <= len(views)
    assert body["build"]["would"] == "estimate_poses"
    assert (body["build"]["camera"], body["build"]["scale"]) == ("given", "depth")
    assert body["sensors"]["depth"]["percentiles_m"][1] > 0.5
    assert body["trajectory"] is body["examination"] is body["path_svg"] is None
    assert body["duration_s"] > 0
    assert not any("depth_scale" in note for note in body["notes"])
    assert any(note.startswith("Check depth_scale: half of") for note in doubtful.json()["notes"])


def test_photos_are_described(museum: Server, views: list[View]) -> None:
    with museum.unchanged():
        body = post(museum, without_poses(views, colour_alone=True), {"scale": {"marker_m": 0.2}}).json()
        bare = post(museum, without_poses(views, colour_alone=True), {"keyframes": {"rule": "pose"}}).json()
    assert (body["format"], body["frames"], body["sensors"]["depth"]) == ("images", len(views), None)
    assert (body["build"]["camera"], body["build"]["scale"]) == ("guess", "marker")
    assert body["build"]["plan_positions"]
    assert (body["duration_s"], body["rate_hz"]) == (0.0, None)
    assert bare["build"]["scale"] is None
    assert not bare["build"]["plan_positions"]
    assert any("has no scale" in note for note in bare["notes"])


def test_pictures_that_a_build_refuses_are_refused(museum: Server, views: list[View]) -> None:
    in_millimetres = [replace(view, depth_m=view.depth_m / 5) for view in views]
    estimate = {"camera": CAMERA_TEXT, "poses": "estimate"}
    for sent, options, message in (
        (views[:4], estimate, "a map needs 8"),
        (in_millimetres, estimate, "unit of the depth images is not stated"),
        (views, {"camera": CAMERA_TEXT}, "has no camera poses"),
    ):
        with museum.unchanged():
            answer = post(museum, without_poses(sent), options)
        assert_problem(answer, 422, "invalid_scan")
        assert message in answer.json()["detail"]


def test_a_scale_beside_poses_is_refused(museum: Server, scan_zip: bytes) -> None:
    answer = post(museum, scan_zip, {"camera": CAMERA_TEXT, "scale": {"marker_m": 0.2}})
    assert_problem(answer, 422, "invalid_scan")
    assert "this scan has poses" in answer.json()["detail"]


def test_it_needs_the_key(tmp_path_factory: pytest.TempPathFactory, scan_zip: bytes) -> None:
    with running(tmp_path_factory.mktemp("locked"), run_worker=False, admin_key="secret") as server:
        assert_problem(post(server, scan_zip), 401)
