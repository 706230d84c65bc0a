"""What a caller may say of a camera."""

from __future__ import annotations

import numpy as np
import pytest

from app.errors import InvalidCameraError, InvalidInputError
from app.geometry.camera import Camera
from app.geometry.camera_hint import CameraHint, hint_of, parse_camera_hint

SIZE = {"width": 640, "height": 480}
FOUR = (500.0, 501.0, 320.0, 240.0)


@pytest.mark.parametrize(
    "value",
    [
        list(FOUR),
        "500, 501,320,240",
        "500 501 320 240",
        "500;501; 320;240",
        [[500, 0, 320], [0, 501, 240], [0, 0, 1]],
        # Column by column, as ARKit's simd matrices, and as nine numbers, as ROS's K.
        [[500, 0, 0], [0, 501, 0], [320, 240, 1]],
        [500, 0, 320, 0, 501, 240, 0, 0, 1],
        [500, 0, 0, 0, 501, 0, 320, 240, 1],
        "500,0,320,0,501,240,0,0,1",
    ],
)
def test_numbers_are_for_images_of_any_size(value: object) -> None:
    hint = parse_camera_hint(value)
    assert hint == CameraHint(values=FOUR)
    assert hint.for_image(640, 480) == Camera("PINHOLE", 640, 480, FOUR)


def test_nothing_is_no_hint() -> None:
    assert parse_camera_hint(None) is None
    assert parse_camera_hint("") is None


def test_a_whole_camera_is_scaled() -> None:
    hint = parse_camera_hint({**SIZE, "params": FOUR})
    assert hint is not None
    assert hint.for_image(320, 240).focal_px == pytest.approx(250.25)


@pytest.mark.parametrize(
    ("model", "params", "same"),
    [
        ("SIMPLE_PINHOLE", [500, 320, 240], ("PINHOLE", (500, 500, 320, 240))),
        ("SIMPLE_RADIAL", [500, 320, 240, 0.1], ("OPENCV", (500, 500, 320, 240, 0.1, 0, 0, 0))),
        ("RADIAL", [500, 320, 240, 0.1, -0.02], ("OPENCV", (500, 500, 320, 240, 0.1, -0.02, 0, 0))),
        (
            "SIMPLE_RADIAL_FISHEYE",
            [300, 320, 240, 0.05],
            ("OPENCV_FISHEYE", (300, 300, 320, 240, 0.05, 0, 0, 0)),
        ),
    ],
)
def test_colmaps_simple_models_are_special_cases(
    model: str, params: list[float], same: tuple[str, tuple[float, ...]]
) -> None:
    hint = parse_camera_hint({"model": model, **SIZE, "params": params})
    assert hint == hint_of(Camera(same[0], 640, 480, same[1]))


def test_the_json_form_is_read_back() -> None:
    for value in (list(FOUR), {"model": "OPENCV", **SIZE, "params": [*FOUR, 0.1, 0.0, 0.0, 0.0]}):
        hint = parse_camera_hint(value)
        assert hint is not None
        assert parse_camera_hint(hint.to_json()) == hint


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ([1, 2, 3], "4, 8 or 9"),
        ("a,b,c,d", "not a number"),
        ([0, 500, 320, 240], "above zero"),
        ([np.nan, 500, 320, 240], "finite"),
        ([[500, 0, 320], [0, 500, 240], [0, 0, 2]], "3x3 matrix must be"),
        ([500, 0, 320, 0, 500, 240, 0, 0, 2], "3x3 matrix must be"),
        ([[500, 3, 320], [0, 500, 240], [0, 0, 1]], "skew"),
        ([[500, 0, 0], [3, 500, 0], [320, 240, 1]], "skew"),
        ("500,5;501,5;320,0;240,0", "commas between its numbers and points in them"),
        ("500,5 501,5 320,0 240,0", "commas between its numbers and points in them"),
        ("500,5,501,5,320,2,240,7", "commas between its numbers and points in them"),
        ([True, 500, 320, 240], "true or false"),
        (["500", 500, 320, 240], "a number as text"),
        (True, "must be numbers"),
        ([0.78, 1.04, 0.5, 0.49], "shares of the image's width and height"),
        ({**SIZE, "width": "640", "params": FOUR}, "all numbers"),
        ({**SIZE, "width": True, "params": FOUR}, "all numbers"),
        ({**SIZE, "params": "5555"}, "all numbers"),
        ({"model": "SIMPLE", **SIZE, "params": [1]}, "SIMPLE_RADIAL"),
        ({**SIZE, "params": FOUR, "fov": 60}, "fov"),
        ({"params": FOUR}, "width, height"),
        (7, "must be numbers"),
    ],
)
def test_what_says_no_camera_is_refused(value: object, words: str) -> None:
    with pytest.raises(InvalidInputError, match=words):
        parse_camera_hint(value)


def test_a_camera_of_the_other_orientation_or_count_is_refused() -> None:
    with pytest.raises(InvalidCameraError, match="3 parameters"):
        parse_camera_hint({"model": "SIMPLE_PINHOLE", **SIZE, "params": [500, 501, 320, 240]})
    with pytest.raises(InvalidCameraError, match="EXIF"):
        hint_of(Camera("PINHOLE", 640, 480, FOUR)).for_image(480, 640)
