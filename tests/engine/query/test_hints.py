"""Hints: what would help a picture that could not be placed."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from app.engine.query.hints import camera_hints, picture_hints, view_hints
from app.engine.query.localizer import Localizer
from app.vision.images import to_gray
from tests.rendered_maps import localizer_of
from tests.scenes import CAMERA, View

SIZE_PX = (640, 480)
NONE = np.zeros((0, 2))


def around(u: float, v: float) -> np.ndarray:
    """Return pixels around one."""
    return np.array([u, v]) + np.random.default_rng(0).normal(scale=20.0, size=(30, 2))


@pytest.mark.parametrize(
    ("pixel", "hints"),
    [
        ((320, 240), ("step_back",)),
        ((500, 240), ("turn_right",)),
        ((120, 240), ("turn_left",)),
        ((320, 400), ("tilt_down",)),
        ((320, 80), ("tilt_up",)),
        ((120, 80), ("turn_left", "tilt_up")),
        ((540, 410), ("turn_right", "tilt_down")),
    ],
    ids=str,
)
def test_what_was_recognised_belongs_in_the_middle(pixel: tuple[int, int], hints: tuple[str, ...]) -> None:
    assert view_hints("too_few_inliers", around(*pixel), SIZE_PX) == hints


def test_another_view_helps_where_this_one_says_nothing() -> None:
    assert view_hints("no_match", NONE, SIZE_PX) == ("look_elsewhere",)
    assert view_hints("ambiguous", around(120, 80), SIZE_PX) == ("look_elsewhere",)
    assert view_hints("outside_venue", around(120, 80), SIZE_PX) == ("go_where_it_is_mapped",)


def test_a_camera_that_the_matches_contradict_is_to_be_checked() -> None:
    assert camera_hints("contradicted") == camera_hints("disputed") == ("check_camera",)
    assert camera_hints("confirmed") == camera_hints("open") == camera_hints("fitted") == ()


def test_a_picture_may_be_dark_white_blurred_or_empty(views: list[View]) -> None:
    clear = views[3].rgb
    gray = to_gray(clear)
    assert picture_hints(gray, 300) == ()
    assert picture_hints(gray, 20) == ("step_back",)
    assert picture_hints((gray * 0.15).astype(np.uint8), 300)[0] == "more_light"
    assert picture_hints(np.full((480, 640), 240, np.uint8), 0) == ("less_light", "step_back")
    assert picture_hints(cv2.GaussianBlur(gray, (0, 0), 6), 300) == ("hold_still",)


@pytest.fixture(scope="module")
def localizer(views: list[View]) -> Localizer:
    return localizer_of(views)


def test_a_located_picture_has_no_hints_and_a_refused_one_has(
    localizer: Localizer, views: list[View]
) -> None:
    assert localizer.localize(views[3].rgb, CAMERA).hints == ()
    noise = np.random.default_rng(1).integers(0, 255, views[3].rgb.shape, dtype=np.uint8)
    refused = localizer.localize(noise, CAMERA)
    assert refused.world_from_camera is None
    assert "look_elsewhere" in refused.hints
    black = localizer.localize(np.zeros_like(noise), CAMERA)
    assert (black.reason, black.hints[0]) == ("poor_image", "more_light")
