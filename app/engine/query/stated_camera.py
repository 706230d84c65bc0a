"""Whether a stated camera can be the one of an image, by its numbers alone; and if not, what was probably meant."""

from __future__ import annotations

import math
from dataclasses import dataclass

from app.errors import InvalidCameraError
from app.geometry.camera import Camera, as_shares, off_centre_ratio
from app.geometry.camera_hint import CameraHint
from app.geometry.turns import turned_camera
from app.limits import limit

# The sides of an image that a sensor records, longer over shorter.
ASPECTS = (4 / 3, 3 / 2, 16 / 9, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class StatedCameraOptions:
    """Where a principal point is plausible."""

    max_offset_ratio: float = limit(
        0.12,
        "Largest distance of the principal point from the image's centre, relative to the image's size.",
        chosen="By hand: lenses and stabilisation stay within a few percent; portrait and landscape of a 4:3 sensor "
        "mixed up are off by 0.17.",
    )
    fit_ratio: float = limit(
        0.06,
        "Distance within which a principal point fits another reading of the numbers.",
        chosen="By hand.",
    )
    aspect_tolerance: float = limit(
        0.05,
        "Largest relative difference of the two scales of numbers that are for an image of another size.",
        chosen="By hand: as far as lenses move principal points, and less than usual shapes differ.",
    )
    usual_aspect_tolerance: float = limit(
        0.02, "The same for the usual shapes of images, of which there are several.", chosen="By hand."
    )


OPTIONS = StatedCameraOptions()


@dataclass(frozen=True, slots=True)
class StatedCamera:
    """The camera of an image as it was stated, turned with the image where that is beyond doubt."""

    camera: Camera
    is_turned: bool


def stated_camera(hint: CameraHint, width: int, height: int, quarter_turns: int) -> StatedCamera:
    """Return the camera that a hint states for an upright image of this size.

    `quarter_turns` is how often the file's orientation turned the recorded image by 90 degrees counter-clockwise. A
    camera of the image as it was recorded is turned with it where only that makes sense. Raises `InvalidCameraError`
    with the likely cause for a camera that can't be the image's.
    """
    try:
        camera = hint.for_image(width, height)
    except InvalidCameraError as error:
        turned = _turned(hint, width, height, quarter_turns)
        if turned is not None:
            return StatedCamera(turned, is_turned=True)
        cause = _likely_cause(hint, width, height)
        raise error if cause is None else InvalidCameraError(cause) from None
    if off_centre_ratio(camera.params[2], camera.params[3], width, height) <= OPTIONS.max_offset_ratio:
        return StatedCamera(camera, is_turned=False)
    turned = _turned(hint, width, height, quarter_turns)
    if turned is not None:
        return StatedCamera(turned, is_turned=True)
    cause = _likely_cause(hint, width, height)
    if cause is None and hint.camera is not None:
        # A whole camera states the size that it is for: an image cut off its centre is possible.
        return StatedCamera(camera, is_turned=False)
    raise InvalidCameraError(cause or _far_off(camera))


def _turned(hint: CameraHint, width: int, height: int, quarter_turns: int) -> Camera | None:
    """Return the camera of the image as it was recorded, turned as the file's orientation says, if it fits."""
    if quarter_turns % 2 == 0:
        return None
    try:
        recorded = hint.for_image(height, width)
    except InvalidCameraError:
        return None
    fits = off_centre_ratio(recorded.params[2], recorded.params[3], height, width) <= OPTIONS.fit_ratio
    return turned_camera(recorded, quarter_turns) if fits else None


def _likely_cause(  # noqa: PLR0911 - one line for each reading of the numbers
    hint: CameraHint, width: int, height: int
) -> str | None:
    """Return a sentence that names what was probably meant, None where nothing fits."""
    values = hint.values or (() if hint.camera is None else hint.camera.params)
    if hint.camera is not None and (hint.camera.width, hint.camera.height) != (width, height):
        # It states another size, so that the numbers are not for this one.
        return None
    shares = as_shares(values, width, height)
    if shares is not None:
        return shares
    cx, cy = values[2], values[3]
    if off_centre_ratio(cx, cy, width, height) <= OPTIONS.max_offset_ratio:
        return None
    across, down = 100 * (cx + 0.5) / width, 100 * (cy + 0.5) / height
    where = f"the principal point ({cx:g}, {cy:g}) is {across:.0f} % across and {down:.0f} % down an image of"
    if width != height and off_centre_ratio(cx, cy, height, width) <= OPTIONS.fit_ratio:
        one, other = ("portrait", "landscape") if height > width else ("landscape", "portrait")
        return (
            f"These are the intrinsics of a {other} image, but the upright image is {one}: {where} {width} x {height} "
            f"pixels. Turn the intrinsics with the image: swap fx and fy, cx and cy."
        )
    whole = None if hint.camera is not None else _cut_from(cx, cy, width, height)
    if whole is not None:
        return (
            f"These seem to be the intrinsics of an image of {whole[0]} x {whole[1]} pixels of which this one was cut: "
            f"{where} {width} x {height} pixels. Subtract what was cut off from cx and cy."
        )
    own_width, own_height = 2 * cx + 1, 2 * cy + 1
    if min(own_width, own_height) <= 0:
        return None
    seem = f"These seem to be the intrinsics of an image of {own_width:.0f} x {own_height:.0f} pixels"
    ratio = own_width / width, own_height / height
    if abs(ratio[0] / ratio[1] - 1) <= OPTIONS.aspect_tolerance:
        return (
            f"{seem}: {where} {width} x {height} pixels. Scale fx, fy, cx, cy by "
            f"{1 / math.sqrt(ratio[0] * ratio[1]):.3g}, or send the camera as JSON with the width and height that it "
            "is for."
        )
    # A whole camera states the size of the cut image.
    if hint.camera is not None or not _is_usual(own_width / own_height):
        return None
    return (
        f"{seem}, which has another shape: {where} {width} x {height} pixels. Give the intrinsics of the image that is "
        "sent: of ARCore its image intrinsics, not those of the texture."
    )


def _cut_from(cx: float, cy: float, width: int, height: int) -> tuple[int, int] | None:
    """Return the size of the image with a principal point in its middle of which an image is the upper or left part, as
    wide or as high as it; None for none of a usual shape."""
    upright = (aspect if width >= height else 1 / aspect for aspect in ASPECTS)
    sizes = [size for a in upright for size in ((width, round(width / a)), (round(height * a), height))]
    larger = [size for size in sizes if size[0] >= width and size[1] >= height and size != (width, height)]
    best = min(larger, key=lambda size: off_centre_ratio(cx, cy, *size), default=None)
    return best if best is not None and off_centre_ratio(cx, cy, *best) <= OPTIONS.fit_ratio else None


def _is_usual(aspect: float) -> bool:
    """Whether a sensor records images of about this shape."""
    return any(abs(max(aspect, 1 / aspect) / each - 1) <= OPTIONS.usual_aspect_tolerance for each in ASPECTS)


def _far_off(camera: Camera) -> str:
    cx, cy = camera.params[2:4]
    return (
        f"The principal point ({cx:g}, {cy:g}) is far from the centre of an image of {camera.width} x {camera.height} "
        "pixels: give the intrinsics of this very image, or send the camera as JSON with its width and height."
    )
