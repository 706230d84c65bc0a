"""Other ways to read a scan's poses, each with the sentence that says so."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from app.importers.conventions import ALL_AXES, PoseArrays, PoseConvention

# Axes that are met in the field; others are named by their letters.
_KNOWN_AXES = {
    "rdf": ("opencv", "x right, y down, z forward, as OpenCV has them"),
    "rub": ("opengl", "x right, y up, z back, as OpenGL, ARKit and Blender have them"),
    "flu": ("ros", "x forward, y left, z up, as a ROS body has them"),
    "ruf": ("unity", "x right, y up, z forward, left-handed, as Unity has them"),
}
# Pictures that are mirrored are the same as axes mirrored in x, which nobody writes.
_MIRRORED = "ldf"
# rdf turned by quarters about z, counter-clockwise as the picture is seen: a picture that was turned.
_TURNED = {"urf": 90, "luf": 180, "dlf": 270}
# A way that is hardly ever met must fit so much better than a common one.
_RARE_RATIO = 1.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """A way to read the poses: its code, what it says about them, and the options that state it.

    `penalty` multiplies its score; without `options` it can be named and not mended.
    """

    code: str
    convention: PoseConvention
    says: str
    options: dict[str, Any]
    penalty: float = 1.0


def other_readings(present: PoseConvention) -> Iterator[Reading]:
    """Yield the ways to read poses that differ from the present one in one thing, or in two that go together."""
    yield from _turned(present)
    yield from _axes(present)
    yield from _directions(present)
    yield from _quaternions(present)


def _turned(present: PoseConvention) -> Iterator[Reading]:
    for turn in (90, 180, 270):
        turned = (present.rotate_deg + turn) % 360
        yield Reading(
            code="turned_pictures",
            convention=replace(present, rotate_deg=turned),
            says=f"The pictures are turned by {turned} degrees counter-clockwise against the camera of the poses",
            options={"rotate_deg": turned},
        )


def _axes(present: PoseConvention) -> Iterator[Reading]:
    for axes in ALL_AXES:
        if axes == present.axes or (present.axes == "rdf" and axes in _TURNED):
            continue
        name, words = _KNOWN_AXES.get(axes, (axes, "by letters " + axes))
        mirrored = axes == _MIRRORED and present.axes == "rdf"
        yield Reading(
            code="mirrored_pictures" if mirrored else "camera_axes",
            convention=replace(present, axes=axes),
            says="The pictures are mirrored, left for right: save them as the camera saw them"
            if mirrored
            else f"The camera axes of the poses are {words}",
            options={} if mirrored else {"axes": name},
            penalty=1.0 if axes in _KNOWN_AXES or mirrored else _RARE_RATIO,
        )


def _directions(present: PoseConvention) -> Iterator[Reading]:
    for axes in dict.fromkeys((present.axes, "rdf", "rub")):
        direction = "camera_from_world" if present.poses == "world_from_camera" else "world_from_camera"
        yield Reading(
            code="inverted_poses",
            convention=replace(present, poses=direction, axes=axes),  # type: ignore[arg-type]
            says=f"The poses are {direction}, not {present.poses}{_with_axes(present, axes)}",
            options={"poses": direction, **_axes_option(present, axes)},
            penalty=1.0 if axes == present.axes else 1.2,
        )
    yield Reading(
        code="transposed_rotations",
        convention=replace(present, poses="rotation_transposed"),
        says="The rotations of the poses are camera_from_world beside positions of the camera in the world",
        options={"poses": "rotation_transposed"},
        penalty=_RARE_RATIO,
    )


def _quaternions(present: PoseConvention) -> Iterator[Reading]:
    order = "wxyz" if present.quaternion == "xyzw" else "xyzw"
    for poses in dict.fromkeys((present.poses, "camera_from_world")):
        for axes in dict.fromkeys((present.axes, "rub")):
            changed = poses != present.poses
            yield Reading(
                code="quaternion_order",
                convention=replace(present, quaternion=order, poses=poses, axes=axes),  # type: ignore[arg-type]
                says=f"The quaternions of the poses are written {' '.join(f'q{letter}' for letter in order)}"
                + (f", and the poses are {poses}" if changed else "")
                + _with_axes(present, axes),
                options={
                    "quaternion": order,
                    **({"poses": poses} if changed else {}),
                    **_axes_option(present, axes),
                },
                penalty=1.2 if changed or axes != present.axes else 1.0,
            )


def _with_axes(present: PoseConvention, axes: str) -> str:
    return "" if axes == present.axes else f", and their camera axes are {_KNOWN_AXES[axes][1]}"


def _axes_option(present: PoseConvention, axes: str) -> dict[str, str]:
    return {} if axes == present.axes else {"axes": _KNOWN_AXES[axes][0]}


def other_orders(names: list[str], poses: PoseArrays) -> Iterator[tuple[str, PoseArrays]]:
    """Yield what may have happened to the order of poses, and the poses put back."""
    count = len(names)
    yield "The poses are in the reverse order of the pictures", _taken(poses, np.arange(count)[::-1])
    # Row i of a list sorted as text belongs to the picture whose number is i-th as text.
    as_text = np.array(sorted(range(count), key=str))
    back = np.empty(count, dtype=np.intp)
    back[as_text] = np.arange(count)
    yield "The poses are those of pictures sorted as text (1, 10, 11, 2)", _taken(poses, back)
    yield "The pictures are sorted as text (1, 10, 11, 2), the poses by number", _taken(poses, as_text)


def _taken(poses: PoseArrays, rows: np.ndarray[Any, np.dtype[np.intp]]) -> PoseArrays:
    return PoseArrays(poses.rotations[rows], poses.positions[rows])
