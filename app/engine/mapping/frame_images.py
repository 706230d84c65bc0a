"""The colour images of a scan's frames."""

from __future__ import annotations

from app.errors import InvalidImageError, InvalidScanError
from app.importers.frames import Frame, FrameSource
from app.vision.images import Rgb, decode_image


def frame_rgb(source: FrameSource, frame: Frame) -> Rgb:
    """Return a frame's RGB image (height, width, 3).

    Raises `InvalidScanError`, which names the frame, when it can't be decoded or differs in size from the camera.
    """
    camera = source.camera
    try:
        rgb = decode_image(source.color_bytes(frame))
    except InvalidImageError as error:
        raise InvalidScanError(f"{frame.name} can't be used: {error}") from None
    if rgb.shape[:2] != (camera.height, camera.width):
        raise InvalidScanError(
            f"{frame.name} has {rgb.shape[1]} x {rgb.shape[0]} pixels, the camera {camera.width} x {camera.height}."
        )
    return rgb
