"""`POST /database/inspect`: what a scan holds, the same refusals as a build, and nothing that stays."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET

import httpx
import pytest

from tests.scenes import CAMERA_TEXT, View, scan_files, zipped
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


def test_it_needs_the_key(tmp_path_factory: pytest.TempPathFactory, scan_zip: bytes) -> None:
    with running(tmp_path_factory.mktemp("locked"), run_worker=False, admin_key="secret") as server:
        assert_problem(post(server, scan_zip), 401)
