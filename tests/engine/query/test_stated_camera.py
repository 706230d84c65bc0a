"""Cameras that can't be the image's own, by their numbers alone, and what was probably meant."""

from __future__ import annotations

import pytest

from app.engine.query.stated_camera import stated_camera
from app.errors import InvalidCameraError
from app.geometry.camera import Camera
from app.geometry.camera_hint import CameraHint, hint_of

LANDSCAPE = CameraHint(values=(1500.0, 1501.0, 955.0, 722.0))


@pytest.mark.parametrize("offset_px", [0.0, 60.0, -100.0])
def test_a_principal_point_near_the_centre_is_taken(offset_px: float) -> None:
    hint = CameraHint(values=(1500.0, 1500.0, 960.0 + offset_px, 720.0 - offset_px))
    found = stated_camera(hint, 1920, 1440, 0)
    assert not found.is_turned
    assert found.camera.params == hint.values


@pytest.mark.parametrize("turns", [1, 3])
def test_the_camera_of_the_image_as_it_was_recorded_is_turned_with_it(turns: int) -> None:
    found = stated_camera(LANDSCAPE, 1440, 1920, turns)
    assert found.is_turned
    assert (found.camera.width, found.camera.height) == (1440, 1920)
    assert found.camera.params[:2] == (1501.0, 1500.0)
    down = 955.0 if turns == 3 else 1919 - 955.0
    assert found.camera.params[3] == pytest.approx(down)


def test_one_that_is_upright_already_is_not_turned() -> None:
    hint = CameraHint(values=(1500.0, 1501.0, 722.0, 955.0))
    assert not stated_camera(hint, 1440, 1920, 3).is_turned


@pytest.mark.parametrize(
    ("hint", "size", "words"),
    [
        (LANDSCAPE, (1440, 1920), "landscape image, but the upright image is portrait"),
        (CameraHint(values=(1500.0, 1500.0, 720.0, 960.0)), (1920, 1440), "portrait image, but the upright"),
        (
            CameraHint(values=(750.0, 750.0, 479.5, 359.5)),
            (1920, 1440),
            "960 x 720 pixels.*25 % across.*Scale.* by 2",
        ),
        (CameraHint(values=(3000.0, 3000.0, 1600.0, 1200.0)), (1920, 1440), "Scale.* by 0.6"),
        (CameraHint(values=(1500.0, 1500.0, 959.5, 719.5)), (1920, 1080), "cut: .*67 % down"),
        # As real lenses have them: principal points a little off.
        (CameraHint(values=(498.0, 498.5, 322.4, 236.8)), (640, 360), "640 x 480 pixels of which .* cut"),
        (CameraHint(values=(498.0, 498.5, 322.4, 236.8)), (480, 480), "640 x 480 pixels of which .* cut"),
        (CameraHint(values=(1000.0, 1000.0, 545.0, 722.0)), (600, 1440), "1080 x 1440 pixels of which .* cut"),
        (CameraHint(values=(1494.0, 1494.0, 966.7, 710.4)), (640, 480), "Scale fx, fy, cx, cy by 0.334"),
        (CameraHint(values=(249.0, 249.0, 161.2, 118.2)), (640, 480), "Scale fx, fy, cx, cy by 2,"),
        (CameraHint(values=(1500.0, 1500.0, 1300.0, 900.0)), (1920, 1440), "far from the centre"),
        (CameraHint(values=(0.78, 1.04, 0.503, 0.493)), (640, 480), "fx and cx by 640, fy and cy by 480"),
        (CameraHint(values=(0.9, 0.9, 0.5, 0.5)), (640, 640), "shares of the image's width"),
        (CameraHint(values=(4.25, 4.25, 320.0, 240.0)), (640, 480), "not in millimetres"),
        (CameraHint(values=(65.4, 51.4, 320.0, 240.0)), (640, 480), "not an angle of view"),
        (CameraHint(values=(1490.0, 1490.0, 959.5, 539.5)), (640, 480), "1920 x 1080 pixels.*another shape"),
    ],
    ids=[
        "turned", "turned back", "half", "double", "cut", "cut rows", "cut columns", "cut portrait", "third", "a half",
        "anything", "shares", "shares of a square", "millimetres",
        "degrees", "texture",
    ],
)  # fmt: skip
def test_an_impossible_camera_is_refused_with_the_likely_cause(
    hint: CameraHint, size: tuple[int, int], words: str
) -> None:
    with pytest.raises(InvalidCameraError, match=words):
        stated_camera(hint, *size, 0)


def test_a_whole_camera_may_be_of_an_image_cut_off_its_centre() -> None:
    cut = hint_of(Camera("PINHOLE", 1000, 800, (900.0, 900.0, 700.0, 380.0)))
    assert stated_camera(cut, 1000, 800, 0).camera == cut.camera


def test_a_whole_camera_whose_numbers_are_for_another_size_is_refused() -> None:
    hint = hint_of(Camera("PINHOLE", 1920, 1440, (1500.0, 1500.0, 660.0, 495.0)))
    with pytest.raises(InvalidCameraError, match="1321 x 991"):
        stated_camera(hint, 1920, 1440, 0)


def test_a_whole_camera_in_shares_of_the_image_is_refused() -> None:
    with pytest.raises(InvalidCameraError, match="multiply fx and cx by 640, fy and cy by 480"):
        Camera("PINHOLE", 640, 480, (0.78, 1.04, 0.503, 0.493))
