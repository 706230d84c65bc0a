"""Figures of a scan: its frames, sensors, extent and path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.geometry.alignment import world_from_scan_by_gravity
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.importers.frames import Scan
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class FigureOptions:
    """How many frames are read for the figures."""

    depth_images: int = limit(
        10, "Depth images that are read for what the sensor reaches.", chosen="By hand: they take a second."
    )


OPTIONS = FigureOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanFigures:
    """What a scan's frames say together.

    `extent_m` is the size of the box around the cameras' positions, along x, y and z of a frame whose z is up where
    gravity is known. `rate_hz` is the median number of frames a second. `depth_share` is the share of colour pixels
    that have depth, `depth_m` the 5th, 50th and 95th percentile of it; None without depth.
    """

    frames: int
    discarded: dict[str, int]
    camera: Camera
    depth_size: tuple[int, int] | None
    depth_share: float | None
    depth_m: tuple[float, float, float] | None
    duration_s: float
    rate_hz: float | None
    path_m: float
    extent_m: tuple[float, float, float]
    z_up: bool

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for JSON, rounded."""
        camera = self.camera
        return {
            "frames": self.frames,
            "discarded": self.discarded,
            "sensors": {
                "color": {
                    "model": camera.model,
                    "width": camera.width,
                    "height": camera.height,
                    "params": [round(value, 4) for value in camera.params],
                },
                "depth": None
                if self.depth_size is None or self.depth_m is None
                else {
                    "width": self.depth_size[0],
                    "height": self.depth_size[1],
                    "share_of_pixels": round(self.depth_share or 0.0, 3),
                    "percentiles_m": [round(value, 2) for value in self.depth_m],
                },
            },
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
    steps_s = np.diff(times_s)
    steps_s = steps_s[steps_s > 0]
    share, percentiles = _depth(scan)
    x, y, z = (positions.max(axis=0) - positions.min(axis=0)).tolist()
    source = scan.depth.camera or scan.camera
    return ScanFigures(
        frames=len(scan.frames),
        discarded={reason: len(names) for reason, names in scan.discarded.items()},
        camera=scan.camera,
        depth_size=(source.width, source.height) if scan.has_depth else None,
        depth_share=share,
        depth_m=percentiles,
        duration_s=float(times_s[-1] - times_s[0]),
        rate_hz=float(1.0 / np.median(steps_s)) if len(steps_s) else None,
        path_m=float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum()),
        extent_m=(x, y, z),
        z_up=gravity is not None,
    )


def positions_of(scan: Scan, gravity: tuple[float, float, float] | None) -> Array:
    """Return the cameras' positions (n, 3), in a frame whose z is up where gravity is known."""
    placed = Pose.identity() if gravity is None else world_from_scan_by_gravity(gravity)
    return placed.apply(np.stack([frame.scan_from_camera.translation for frame in scan.frames]))


def _depth(scan: Scan) -> tuple[float | None, tuple[float, float, float] | None]:
    if not scan.has_depth:
        return None, None
    step = max(1, len(scan.frames) // OPTIONS.depth_images)
    depth_m = np.concatenate([scan.depth_m(frame).ravel() for frame in scan.frames[::step]])
    known = depth_m[depth_m > 0]
    if not len(known):
        return 0.0, (0.0, 0.0, 0.0)
    low, middle, high = np.percentile(known, [5, 50, 95]).tolist()
    return len(known) / len(depth_m), (low, middle, high)
