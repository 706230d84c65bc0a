"""Stated cameras that are not the picture's own: the matches show it, and the answer is right or not sure."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from app.engine.query import intrinsics
from app.engine.query.attempt import attempt
from app.engine.query.attempt.rival import Contest, against_rival
from app.engine.query.hypothesis import Hypothesis
from app.engine.query.intrinsics import CheckedCamera
from app.engine.query.localization import Localization
from app.engine.query.localizer import Localizer
from app.engine.query.localizer import _later as later
from app.geometry.camera import Camera
from app.geometry.se3 import position_difference_m
from app.vision.images import Rgb
from tests.rendered_maps import localizer_of
from tests.scenes import CAMERA, Room, View, pose_at

SURE_CONFIDENCE = 0.9
SURE_SIGMAS = 3.0


@pytest.fixture(scope="module")
def room() -> Room:
    return Room(seed=3)


@pytest.fixture(scope="module")
def localizer(room: Room) -> Localizer:
    """The map of a few views of a corner."""
    return localizer_of(
        [room.view(pose_at(1.2 + 0.2 * i, 1.0 + 0.1 * i, yaw_deg=20 + 8 * i)) for i in range(6)]
    )


@pytest.fixture(scope="module")
def query(room: Room) -> View:
    return room.view(pose_at(1.5, 1.3, yaw_deg=38))


def zoomed(rgb: Rgb, zoom: float) -> Rgb:
    cx, cy = CAMERA.principal_point_px
    warp = np.array([[zoom, 0.0, (1 - zoom) * cx], [0.0, zoom, (1 - zoom) * cy]])
    return np.asarray(cv2.warpAffine(rgb, warp, (CAMERA.width, CAMERA.height)), np.uint8)


def stretched(ratio: float) -> Camera:
    fx, fy, *rest = CAMERA.params
    return replace(CAMERA, params=(fx, fy * ratio, *rest))


def test_the_right_camera_is_used_as_stated(localizer: Localizer, query: View) -> None:
    found = localizer.localize(query.rgb, CAMERA)
    assert found.world_from_camera is not None
    assert not found.is_refined
    assert position_difference_m(found.world_from_camera, query.world_from_camera) < 0.02


@pytest.mark.parametrize("zoom", [1.15, 1.3, 1.6])
def test_a_digital_zoom_is_found_or_makes_the_answer_unsure(
    zoom: float, localizer: Localizer, query: View
) -> None:
    found = localizer.localize(zoomed(query.rgb, zoom), CAMERA)
    if found.world_from_camera is None:
        return
    assert found.accuracy is not None
    error_m = position_difference_m(found.world_from_camera, query.world_from_camera)
    assert error_m < SURE_SIGMAS * found.accuracy.position_m or found.confidence < SURE_CONFIDENCE
    assert found.is_refined == (found.camera is not None and found.camera.focal_px > 1.05 * CAMERA.focal_px)


@pytest.mark.parametrize("ratio", [1.1, 4 / 3, 0.75])
def test_focal_lengths_that_differ_are_one_where_the_matches_say_so(
    ratio: float, localizer: Localizer, query: View
) -> None:
    found = localizer.localize(query.rgb, stretched(ratio))
    assert found.world_from_camera is not None
    assert found.is_refined
    assert found.camera is not None
    assert found.camera.params[:2] == pytest.approx(CAMERA.params[:2], rel=0.02)
    assert position_difference_m(found.world_from_camera, query.world_from_camera) < 0.03


def test_a_picture_that_was_stretched_with_its_numbers_keeps_them(localizer: Localizer, query: View) -> None:
    tall = np.asarray(cv2.resize(query.rgb, (320, 320), interpolation=cv2.INTER_CUBIC), np.uint8)
    fx, fy, cx, cy = CAMERA.params
    camera = Camera("PINHOLE", 320, 320, (fx, fy * 4 / 3, cx, (cy + 0.5) * 4 / 3 - 0.5))
    found = localizer.localize(tall, camera)
    assert found.world_from_camera is not None
    assert not found.is_refined
    assert position_difference_m(found.world_from_camera, query.world_from_camera) < 0.02


def test_a_camera_that_is_disputed_is_refused_and_named(
    localizer: Localizer, query: View, monkeypatch: pytest.MonkeyPatch
) -> None:
    def disputed(best: Hypothesis, camera: Camera, *_: object) -> CheckedCamera:
        return CheckedCamera(camera=camera, best=best, trust="disputed")

    monkeypatch.setattr(intrinsics, "check_intrinsics", disputed)
    found = localizer.localize(query.rgb, CAMERA)
    assert (found.world_from_camera, found.reason) == (None, "ambiguous")
    assert "check_camera" in found.hints


def test_the_camera_of_a_rival_that_wins_is_checked_by_its_own_matches(
    localizer: Localizer, query: View, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Hypothesis] = []

    def winning(*asked_of: object) -> Contest:
        contest = against_rival(*asked_of)  # type: ignore[arg-type]
        return contest.won_by(replace(contest.best))

    def checked(best: Hypothesis, camera: Camera, *_: object) -> CheckedCamera:
        asked.append(best)
        return CheckedCamera(camera=camera, best=best, trust="confirmed" if len(asked) == 1 else "open")

    monkeypatch.setattr(attempt, "against_rival", winning)
    monkeypatch.setattr(intrinsics, "check_intrinsics", checked)
    found = localizer.localize(query.rgb, CAMERA)
    assert len(asked) == 2
    assert found.camera_trust == "open"


def test_an_accuracy_without_a_stated_camera_counts_its_principal_point(
    localizer: Localizer, query: View
) -> None:
    stated, alone = localizer.localize(query.rgb, CAMERA), localizer.localize(query.rgb, None)
    assert stated.accuracy is not None
    assert alone.accuracy is not None
    assert alone.camera_trust == "fitted"
    # 2.5 % of the picture's width, by its focal length.
    assert alone.accuracy.orientation_deg > 1.0 > stated.accuracy.orientation_deg


def test_a_camera_that_one_look_disputes_is_not_confirmed_by_the_next(query: View) -> None:
    here, elsewhere = query.world_from_camera, pose_at(3.5, 1.3, yaw_deg=200)
    first = Localization(reason="ambiguous", candidate=here, camera_trust="disputed")
    again = Localization(world_from_camera=here, camera_trust="confirmed")
    assert later(first, again) is first
    # Another camera was found; it is another place, of which the first look said nothing; or nothing was disputed.
    refined = replace(again, camera_trust="refined")
    assert later(first, refined) is refined
    other = replace(again, world_from_camera=elsewhere)
    assert later(first, other) is other
    assert later(replace(first, camera_trust="contradicted"), again) is again
