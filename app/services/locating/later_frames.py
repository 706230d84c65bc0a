"""The further frames of a query, decoded."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from app.engine.query.camera_sources import query_camera
from app.engine.query.several.frame import GivenFrame
from app.errors import ImageTooLargeError, InvalidInputError, RoomfixError
from app.services.locate_result import LaterFrame, LocateRequest
from app.vision.images import Rgb, decode_image

METHODS = ("auto", "rgbd")


def decode_later(request: LocateRequest, first: Rgb, max_pixels: int) -> tuple[GivenFrame, ...]:
    """Return the frames after the first picture (height, width, 3); all together have `max_pixels` at most.

    Raises what a single picture and its camera raise, with the frame's number; `InvalidInputError` for a method that
    takes one picture, for a motion without intrinsics, and for frames of which some have a motion.
    """
    _check(request)
    spent = first.shape[0] * first.shape[1]
    frames = []
    for number, later in enumerate(request.later):
        with _named(number, max_pixels):
            frame = _decoded(request, later, max_pixels - spent)
        spent += frame.rgb.shape[0] * frame.rgb.shape[1]
        frames.append(frame)
    return tuple(frames)


def _check(request: LocateRequest) -> None:
    if request.method not in METHODS:
        raise InvalidInputError(
            f"images are for method {' or '.join(METHODS)}; leave them out, or the method."
        )
    moved = [later.first_from_camera is not None for later in request.later]
    if any(moved) and not all(moved):
        raise InvalidInputError("motion is known for all images, or for none.")
    if any(moved) and (request.camera is None or any(later.camera is None for later in request.later)):
        raise InvalidInputError(
            "motion needs the intrinsics of all frames: send camera, and cameras where they differ."
        )


def _decoded(request: LocateRequest, later: LaterFrame, max_pixels: int) -> GivenFrame:
    rgb = decode_image(later.image, max_pixels)
    known = query_camera(later.camera, rgb, later.image).camera
    motion, gravity = later.first_from_camera, None
    if motion is not None and request.gravity is not None:
        x, y, z = (float(value) for value in motion.rotation.T @ request.gravity)
        gravity = x, y, z
    return GivenFrame(rgb=rgb, camera=known, first_from_camera=motion, gravity=gravity)


@contextmanager
def _named(number: int, max_pixels: int) -> Iterator[None]:
    """Say of an error which of the pictures it is about."""
    try:
        yield
    except ImageTooLargeError as error:
        raise ImageTooLargeError(
            f"images[{number}]: {error} The frames of a query have {max_pixels:,} pixels at most, all together."
        ) from None
    except RoomfixError as error:
        raise type(error)(f"images[{number}]: {error}") from None
