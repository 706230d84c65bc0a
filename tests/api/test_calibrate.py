"""`POST /database/calibrate`: figures for a good scan, a problem for a bad one, and nothing that stays."""

from __future__ import annotations

import json
import sys
from typing import Any

import httpx
import pytest

from app.services import calibration
from tests.scenes import CAMERA_TEXT, View, encode, scan_files, zipped
from tests.server import Server, assert_problem, running


def post(server: Server, archive: bytes, venue: str = "museum", options: object = None) -> httpx.Response:
    text = options if isinstance(options, str) else json.dumps(options or {"camera": CAMERA_TEXT})
    return server.client.post(
        "/database/calibrate",
        data={"venue": venue, "options": text},
        files={"archive": ("scan.zip", archive)},
    )


@pytest.fixture(scope="module")
def calibrated(museum: Server, scan_zip: bytes) -> dict[str, Any]:
    """The answer to the scan, sent as an upload; nothing of it stays on the server but the upload itself."""
    with museum.unchanged(), museum.uploaded(scan_zip) as upload:
        form = {"venue": "museum", "options": json.dumps({"camera": CAMERA_TEXT}), "upload": upload}
        answer = museum.client.post("/database/calibrate", data=form)
    assert answer.status_code == 200, answer.text
    return dict(answer.json())


def test_a_scan_is_answered_with_curves_and_thresholds(calibrated: dict[str, Any]) -> None:
    body = calibrated
    assert body["wanted_matches"] == 50
    assert 0.05 < body["thresholds"]["position_m"] < 1.2
    assert 0.1 < body["thresholds"]["attitude_rad"] < 1.2
    for name, field in (("position", "position_m"), ("attitude", "attitude_rad")):
        curve = body[name]
        assert curve["a"] > 0 > curve["b"]
        assert curve["rmse_fit"] >= 0
        assert curve["rmse_validation"] is not None
        assert curve["threshold"] == body["thresholds"][field]
        assert {point["held_back"] for point in curve["points"]} == {True, False}


def test_more_matches_want_nearer_keyframes(
    museum: Server, scan_zip: bytes, calibrated: dict[str, Any]
) -> None:
    options = {"camera": CAMERA_TEXT, "keyframes": {"wanted_matches": 150}}
    strict = post(museum, scan_zip, options=options).json()
    assert strict["thresholds"]["attitude_rad"] < calibrated["thresholds"]["attitude_rad"]


def test_a_build_with_calibrated_thresholds_reports_them(
    museum: Server, scan_zip: bytes, calibrated: dict[str, Any]
) -> None:
    museum.add_venue("annex")
    keyframes = {"rule": "pose", "thresholds": "calibrated"}
    build = museum.build(scan_zip, "annex", keyframes=keyframes)
    assert build["state"] == "succeeded", build
    calibration = build["report"]["calibration"]
    assert calibration["thresholds"] == calibrated["thresholds"]
    assert "points" not in calibration["position"]
    assert "calibrate" in build["report"]["seconds"]


def test_bad_uploads_are_refused_and_leave_nothing(
    museum: Server, views: list[View], scan_zip: bytes
) -> None:
    files = scan_files(views[:8])
    black = encode(views[0].rgb * 0, ".png")
    dark = {name: black if name.startswith("rgb/") else data for name, data in files.items()}
    with museum.unchanged():
        assert_problem(post(museum, b""), 422, "invalid_scan")
        assert_problem(post(museum, b"nonsense" * 100), 422, "invalid_scan")
        assert_problem(post(museum, scan_zip[:20_000]), 422, "invalid_scan")
        assert_problem(post(museum, zipped(scan_files(views[:1]))), 422, "invalid_scan")
        assert_problem(post(museum, zipped(dark)), 422, "invalid_scan")
        assert_problem(post(museum, scan_zip, "nowhere"), 404, "not_found")
        assert_problem(post(museum, scan_zip, options="{"), 422, "invalid_input")
        assert_problem(post(museum, scan_zip, options="[" * 50_000), 422, "invalid_input")
        assert_problem(post(museum, scan_zip, options={"colour": 1}), 422, "invalid_input")
        assert "archive" in assert_problem(
            museum.client.post("/database/calibrate", data={"venue": "museum"}), 422, "invalid_request"
        )


def test_it_needs_the_key(tmp_path_factory: pytest.TempPathFactory, scan_zip: bytes) -> None:
    with running(tmp_path_factory.mktemp("locked"), run_worker=False, admin_key="secret") as server:
        assert_problem(post(server, scan_zip), 401)


def test_a_decoder_that_crashes_ends_one_request(
    museum: Server, scan_zip: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    crash = (sys.executable, "-c", "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    monkeypatch.setattr(calibration, "COMMAND", crash)
    with museum.unchanged():
        assert "damaged" in assert_problem(post(museum, scan_zip), 422, "invalid_scan")
    assert museum.client.get("/healthz").status_code == 200
