"""Figures of a scan: its frames, sensors, extent and path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.geometry.alignment import world_from_scan_by_gravity
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.importers.depth_figures import DepthFigures, depth_figures
from app.importers.frames import Scan

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanFigures:
    """What a scan's frames say together.

    `extent_m` is the size of the box around the cameras' positions, along x, y and z of a frame whose z is up where
    gravity is known. `rate_hz` is the median number of frames a second. `depth` is None without depth.
    """

    frames: int
    discarded: dict[str, int]
    camera: Camera
    depth: DepthFigures | None
    duration_s: float
    rate_hz: float | None
    path_m: float
    extent_m: tuple[float, float, float]
    z_up: bool

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for JSON, rounded."""
        return {
            "frames": self.frames,
            "discarded": self.discarded,
            "sensors": sensors_dict(self.camera, self.depth),
            "duration_s": round(self.duration_s, 2),
            "rate_hz": None if self.rate_hz is None else round(self.rate_hz, 2),
            "trajectory": {
                "path_m": round(self.path_m, 2),
                "extent_m": [round(value, 2) for value in self.extent_m],
                "z_up": self.z_up,
            },
        }


def figures_of(scan: Scan, gravity: tuple[float, float, float] | None) -> ScanFigures:
    """Return the figures of a scan; `gravity` is the direction of down in its frame, if known."""
    positions = positions_of(scan, gravity)
    times_s = np.array([frame.timestamp_s for frame in scan.frames])
    x, y, z = (positions.max(axis=0) - positions.min(axis=0)).tolist()
    return ScanFigures(
        frames=len(scan.frames),
        discarded={reason: len(names) for reason, names in scan.discarded.items()},
        camera=scan.camera,
        depth=depth_figures(scan),
        duration_s=float(times_s[-1] - times_s[0]),
        rate_hz=rate_hz(times_s),
        path_m=float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum()),
        extent_m=(x, y, z),
        z_up=gravity is not None,
    )


def positions_of(scan: Scan, gravity: tuple[float, float, float] | None) -> Array:
    """Return the cameras' positions (n, 3), in a frame whose z is up where gravity is known."""
    placed = Pose.identity() if gravity is None else world_from_scan_by_gravity(gravity)
    return placed.apply(np.stack([frame.scan_from_camera.translation for frame in scan.frames]))


def rate_hz(times_s: Array) -> float | None:
    """Return the median number of frames a second of frames at these times (n,), None where all are the same."""
    steps_s = np.diff(times_s)
    steps_s = steps_s[steps_s > 0]
    return float(1.0 / np.median(steps_s)) if len(steps_s) else None


def sensors_dict(camera: Camera, depth: DepthFigures | None) -> dict[str, Any]:
    """Return what a scan was taken with, for JSON."""
    return {
        "color": {
            "model": camera.model,
            "width": camera.width,
            "height": camera.height,
            "params": [round(value, 4) for value in camera.params],
        },
        "depth": None if depth is None else depth.as_dict(),
    }
