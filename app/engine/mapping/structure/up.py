"""Which way is down in a reconstruction: by the phone's sensors, else vertical edges, else how the camera was held."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.structure.reconstruction import Reconstruction
from app.engine.progress import Progress, map_in_order
from app.geometry.camera import MIN_DEPTH
from app.geometry.triangulation import homogeneous, unit_rays
from app.geometry.vertical import VerticalDirection, vertical_direction
from app.limits import limit
from app.vision.edges import straight_edges
from app.vision.images import Gray

Array = NDArray[np.float64]
# Cameras whose mean axis is shorter than this were turned every way.
MIN_MEAN = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class UpOptions:
    """When the pictures' edges, or the camera's axes, show the vertical."""

    pictures: int = limit(120, "Pictures whose edges are used.", chosen="By hand: some seconds.")
    max_edges: int = limit(
        4000,
        "Longest edges of all pictures that are used.",
        chosen="By hand: on RedKitchen the two halves of the pictures agree from 1500 on.",
    )
    min_edges: int = limit(
        20, "Least number of edges that agree.", chosen="By hand: of two or three pictures."
    )
    min_share: float = limit(
        0.08,
        "Least share of the length of all steep edges that agrees.",
        chosen="By hand: more than twice what edges of any direction leave by chance.",
    )
    max_halves_deg: float = limit(
        5.0,
        "Largest angle between the verticals of every other picture and of those between.",
        chosen="By hand: other directions that edges have by chance differ by far more.",
    )
    min_turn_ratio: float = limit(
        10.0,
        "Least ratio of the second to the third eigenvalue of the cameras' x axes, from which these lie in one plane.",
        chosen="By hand: a camera held level within 10 degrees that turned by 60 or more.",
    )
    min_sensed: int = limit(
        5, "Least number of frames whose down a phone's sensors gave.", chosen="By hand: a few may be wrong."
    )
    max_sensed_deg: float = limit(
        5.0,
        "Largest median angle between the down of the frames and their mean, above which it is not used.",
        chosen="By hand: a phone that is carried stays within 2 degrees; wrong axes are off by far more.",
    )


OPTIONS = UpOptions()


@dataclass(frozen=True, slots=True)
class DownDirection:
    """Down (3,) in the frame of the poses, its figures, and its source: `sensor`, `vertical_edges` or `camera_axes`."""

    down: tuple[float, float, float]
    source: str
    figures: dict[str, Any]

    def as_dict(self) -> dict[str, Any]:
        """Return it for the report."""
        return {"source": self.source, **self.figures}


def down_by_sensor(
    part: Reconstruction, downs: Mapping[int, tuple[float, float, float]]
) -> DownDirection | None:
    """Return the mean of the directions of down that a phone's sensors gave, by row and in the camera's axes.

    None where they are few, or differ too much.
    """
    found = [part.poses[row].rotation @ np.array(down) for row, down in downs.items() if row in part.poses]
    if len(found) < OPTIONS.min_sensed:
        return None
    turned = unit_rays(np.stack(found))
    # The componentwise median: frames that were taken in a jolt count little.
    median = np.median(turned, axis=0)
    if np.linalg.norm(median) < MIN_MEAN:
        return None
    mean = unit_rays(median[None])[0]
    apart_deg = float(np.median(np.degrees(np.arccos(np.clip(turned @ mean, -1.0, 1.0)))))
    if apart_deg > OPTIONS.max_sensed_deg:
        return None
    return _direction(mean, "sensor", {"pictures": len(turned), "apart_deg": round(apart_deg, 2)})


def find_down(
    part: Reconstruction, gray: Callable[[int], Gray], executor: Executor, progress: Progress
) -> DownDirection | None:
    """Return the direction of down, None where neither edges nor camera axes show it; `gray` reads pictures by row."""
    rows = list(part.poses)
    step = max(1, -(-len(rows) // OPTIONS.pictures))
    rotations = np.stack([pose.rotation for pose in part.poses.values()])
    level = _level_frame(rotations)
    if level is None:
        return None

    def look(row: int) -> _Edges:
        starts, ends, lengths = straight_edges(gray(row), part.camera)
        level_from_camera = level @ part.poses[row].rotation
        turned = [homogeneous(points) @ level_from_camera.T for points in (starts, ends)]
        return _Edges(turned[0], turned[1], lengths)

    edges = list(map_in_order(executor, look, rows[::step], "find_up", progress))
    return _by_edges(edges, level) or _by_axes(rotations)


@dataclass(frozen=True, slots=True)
class _Edges:
    """The edges of a picture: rays (n, 3) to their ends in the level frame, and their lengths (n,) in pixels."""

    starts: Array
    ends: Array
    lengths: Array


def _level_frame(rotations: Array) -> Array | None:
    """Return the rotation (3, 3) from the frame of the poses to one whose y is the mean of the cameras' y axes.

    None where these point everywhere.
    """
    down, forward = rotations[:, :, 1].mean(axis=0), rotations[:, :, 2].mean(axis=0)
    right = np.cross(down, forward)
    if min(np.linalg.norm(down), np.linalg.norm(right)) < MIN_MEAN:
        return None
    y, x = unit_rays(down[None])[0], unit_rays(right[None])[0]
    return np.stack([x, y, np.cross(x, y)])


def _by_edges(pictures: Sequence[_Edges], level: Array) -> DownDirection | None:
    """Return the vertical that the edges of all pictures agree on, by every other picture as by those between."""
    whole, *halves = (_vertical(some) for some in (pictures, pictures[::2], pictures[1::2]))
    if whole is None or halves[0] is None or halves[1] is None:
        return None
    apart_deg = float(np.degrees(np.arccos(np.clip(halves[0].down @ halves[1].down, -1.0, 1.0))))
    if apart_deg > OPTIONS.max_halves_deg:
        return None
    figures = {"edges": whole.edges, "share": round(whole.share, 3), "halves_deg": round(apart_deg, 2)}
    return _direction(whole.down @ level, "vertical_edges", figures)


def _vertical(pictures: Sequence[_Edges]) -> VerticalDirection | None:
    if not pictures:
        return None
    starts, ends = (np.concatenate([getattr(p, name) for p in pictures]) for name in ("starts", "ends"))
    lengths = np.concatenate([p.lengths for p in pictures])
    # A ray and its opposite are the same point of the image plane; an edge across its border is neither.
    inside = (starts[:, 2] * ends[:, 2]) > MIN_DEPTH**2
    first, last = (rays[inside, :2] / rays[inside, 2:] for rays in (starts, ends))
    found = vertical_direction(first, last, lengths[inside], max_edges=OPTIONS.max_edges)
    enough = found is not None and found.edges >= OPTIONS.min_edges and found.share >= OPTIONS.min_share
    return found if enough else None


def _by_axes(rotations: Array) -> DownDirection | None:
    """Return the direction across all cameras' x axes: a camera that is held level turns about the vertical."""
    x_axes, y_axes = rotations[:, :, 0], rotations[:, :, 1]
    values, vectors = np.linalg.eigh(x_axes.T @ x_axes / len(x_axes))
    if values[1] < OPTIONS.min_turn_ratio * values[0]:
        return None
    down = vectors[:, 0] * (1.0 if float((y_axes @ vectors[:, 0]).mean()) > 0 else -1.0)
    tilt = float(np.degrees(np.sqrt(values[0])))
    return _direction(down, "camera_axes", {"pictures": len(rotations), "tilt_deg": round(tilt, 2)})


def _direction(down: Array, source: str, figures: dict[str, Any]) -> DownDirection:
    x, y, z = down.tolist()
    return DownDirection((x, y, z), source, figures)
