"""Which way is down in a reconstruction: by the vertical edges in the pictures, else by how the camera was held."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.structure.reconstruction import Reconstruction
from app.engine.progress import Progress, map_in_order
from app.geometry.triangulation import unit_rays
from app.limits import limit
from app.vision.edges import down_in_picture
from app.vision.images import Gray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class UpOptions:
    """When pictures or camera agree on a vertical."""

    pictures: int = limit(
        60, "Pictures in which vertical edges are looked for.", chosen="By hand: a few seconds."
    )
    agreement_deg: float = limit(
        3.0,
        "Largest angle between the verticals of two pictures that agree.",
        chosen="By hand: three sigma of one.",
    )
    min_agreeing: int = limit(5, "Pictures that must agree.", chosen="By hand: fewer may agree by chance.")
    min_agreeing_share: float = limit(
        0.5, "Share of the pictures with a vertical that must agree.", chosen="By hand: a majority."
    )
    min_turn_ratio: float = limit(
        10.0,
        "Least ratio of the second to the third eigenvalue of the cameras' x axes, from which these lie in one plane.",
        chosen="By hand: a camera held level within 10 degrees that turned by 60 or more.",
    )


OPTIONS = UpOptions()


@dataclass(frozen=True, slots=True)
class DownDirection:
    """Down (3,) in the frame of the poses, what it rests on (`vertical_edges` or `camera_axes`), and its figures."""

    down: tuple[float, float, float]
    source: str
    figures: dict[str, Any]

    def as_dict(self) -> dict[str, Any]:
        """Return it for the report."""
        return {"source": self.source, **self.figures}


def find_down(
    part: Reconstruction, gray: Callable[[int], Gray], executor: Executor, progress: Progress
) -> DownDirection | None:
    """Return the direction of down, None where neither edges nor camera axes show it; `gray` reads pictures by row."""
    rows = list(part.poses)
    step = max(1, -(-len(rows) // OPTIONS.pictures))

    def look(row: int) -> Array | None:
        down = down_in_picture(gray(row), part.camera)
        return None if down is None else part.poses[row].rotation @ down

    found = [
        down for down in map_in_order(executor, look, rows[::step], "find_up", progress) if down is not None
    ]
    by_edges = _by_edges(np.array(found).reshape(-1, 3))
    if by_edges is not None:
        return by_edges
    return _by_axes(np.stack([pose.rotation for pose in part.poses.values()]))


def _by_edges(downs: Array) -> DownDirection | None:
    if len(downs) < OPTIONS.min_agreeing:
        return None
    near = downs @ downs.T > np.cos(np.radians(OPTIONS.agreement_deg))
    agreeing = near[int(np.argmax(near.sum(axis=1)))]
    if agreeing.sum() < max(OPTIONS.min_agreeing, OPTIONS.min_agreeing_share * len(downs)):
        return None
    down = unit_rays(downs[agreeing].mean(axis=0)[None])[0]
    angles = np.degrees(np.arccos(np.clip(downs[agreeing] @ down, -1.0, 1.0)))
    figures = {
        "pictures": int(agreeing.sum()),
        "of": len(downs),
        "median_deg": round(float(np.median(angles)), 2),
    }
    return _direction(down, "vertical_edges", figures)


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
