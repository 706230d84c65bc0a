"""The further frames of a query: pictures, their motion and their cameras, checked against each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from fastapi import UploadFile

from app.api.requests.axes import Axes, pose_of
from app.api.requests.read_json import read_json
from app.errors import InvalidInputError, InvalidPoseError
from app.geometry.camera_hint import CameraHint, parse_camera_hint
from app.geometry.se3 import Pose
from app.limits import limit
from app.services.locate_result import LaterFrame


@dataclass(frozen=True, slots=True, kw_only=True)
class SeveralFrameOptions:
    """Bounds of a query of several frames."""

    max_frames: int = limit(
        8,
        "Largest number of frames of a query, image among them.",
        chosen="By hand: each costs as much time as a query of its own.",
    )
    max_motion_m: float = limit(
        5.0,
        "Largest distance of a frame from frame 0.",
        chosen="By hand: a burst of a few seconds is shorter, and a rig is smaller.",
    )


OPTIONS = SeveralFrameOptions()
IMAGES_IN_WORDS = (
    "Further frames of a burst or a rig: repeat the part, at most 7 times. "
    "The answer is about image, by all of them"
)
MOTION_IN_WORDS = (
    "JSON list, one for each of images: its camera's pose in the camera of image, {position, quaternion} or a 4x4 "
    "matrix, metres, in the axes of the request. Leave it out where it is not known"
)
CAMERAS_IN_WORDS = (
    "JSON list, one for each of images: its intrinsics as in camera, or null; "
    "without the field all have camera"
)


async def later_frames(
    images: Sequence[UploadFile],
    motion: str | None,
    cameras: str | None,
    camera: CameraHint | None,
    axes: Axes,
) -> tuple[LaterFrame, ...]:
    """Return the frames after the first; raises `InvalidInputError` for fields that don't fit each other."""
    if len(images) >= OPTIONS.max_frames:
        raise InvalidInputError(
            f"images holds {len(images)} pictures: a query has at most {OPTIONS.max_frames} frames, image among them."
        )
    motions = _motions(motion, len(images), axes)
    hints = _hints(cameras, len(images), camera)
    contents = [await image.read() for image in images]
    return tuple(
        LaterFrame(image=content, camera=hint, first_from_camera=pose)
        for content, hint, pose in zip(contents, hints, motions, strict=True)
    )


def _motions(text: str | None, count: int, axes: Axes) -> list[Pose | None]:
    if text is None or not text.strip():
        return [None] * count
    poses = [axes.motion_in(_motion(value, k)) for k, value in enumerate(_listed(text, "motion", count))]
    for k, pose in enumerate(poses):
        if float(np.linalg.norm(pose.translation)) > OPTIONS.max_motion_m:
            raise InvalidInputError(
                f"motion[{k}] is {np.linalg.norm(pose.translation):.1f} m long: frames of a query are at most "
                f"{OPTIONS.max_motion_m:g} m from image. Is it a pose in the world, or in other units?"
            )
    return list(poses)


def _motion(value: object, k: int) -> Pose:
    if not isinstance(value, list):
        return pose_of(value, f"motion[{k}]")
    try:
        return Pose.from_matrix(value)
    except (ValueError, TypeError, InvalidPoseError) as error:
        why = str(error) if isinstance(error, InvalidPoseError) else "It is no 4x4 matrix of numbers."
        raise InvalidInputError(f"motion[{k}] is no rigid transform: {why}") from None


def _hints(text: str | None, count: int, camera: CameraHint | None) -> list[CameraHint | None]:
    if text is None or not text.strip():
        return [camera] * count
    return [None if value is None else parse_camera_hint(value) for value in _listed(text, "cameras", count)]


def _listed(text: str, name: str, count: int) -> list[object]:
    """Return the values of a field that has one for each of images."""
    values = read_json(text, name)
    if not isinstance(values, list):
        raise InvalidInputError(f"{name} must be a JSON list with one entry for each of images.")
    if len(values) != count:
        raise InvalidInputError(
            f"{name} has {len(values)} entries for {count} images: it needs one for each, and none for image itself."
        )
    return values
