"""The vertical that a picture's edges show."""

from __future__ import annotations

import cv2
import numpy as np

from app.geometry.camera import Camera
from app.geometry.se3 import rotation_from_vector
from app.vision.edges import down_in_picture

CAMERA = Camera("PINHOLE", 640, 480, (420.0, 420.0, 319.5, 239.5))


def corridor(camera_from_room: np.ndarray) -> np.ndarray:
    """Return a picture of posts, and of beams in two level directions, by a camera turned in a room."""
    picture = np.full((480, 640), 200, np.uint8)
    posts = [((x, -1.5, z), (x, 1.5, z)) for z in (3.0, 4.5, 6.0) for x in np.arange(-3.0, 3.1, 0.5)]
    beams = [((-3.0, y, 6.0), (3.0, y, 6.0)) for y in (-1.5, 1.5)]
    beams += [((x, y, 3.0), (x, y, 6.0)) for x in (-3.0, 3.0) for y in (-1.5, 1.5)]
    for first, second in posts + beams:
        ends = np.array([first, second]) @ camera_from_room.T
        u, v = np.rint(CAMERA.project(ends)).astype(int)
        cv2.line(picture, u.tolist(), v.tolist(), 40, 2)
    return picture


def test_posts_tell_the_vertical_of_a_camera_that_looks_down_and_is_rolled() -> None:
    camera_from_room = rotation_from_vector([0.25, 0.0, 0.0]) @ rotation_from_vector([0.0, 0.3, 0.12])
    down = down_in_picture(corridor(camera_from_room), CAMERA)
    assert down is not None
    assert np.degrees(np.arccos(np.clip(down @ camera_from_room[:, 1], -1.0, 1.0))) < 0.7


def test_a_picture_without_edges_tells_none() -> None:
    assert down_in_picture(np.full((480, 640), 90, np.uint8), CAMERA) is None
    noise = np.random.default_rng(0).integers(0, 255, (480, 640)).astype(np.uint8)
    assert down_in_picture(cv2.GaussianBlur(noise, (0, 0), 6), CAMERA) is None
