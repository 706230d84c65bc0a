"""What the depth images of a scan hold, by some of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from app.importers.frames import Scan
from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class FigureOptions:
    """How many frames are read for the figures."""

    depth_images: int = limit(
        10, "Depth images that are read for what the sensor reaches.", chosen="By hand: they take a second."
    )


OPTIONS = FigureOptions()


@dataclass(frozen=True, slots=True)
class DepthFigures:
    """Width and height of depth images, the `share` of pixels that have depth, and percentiles 5, 50, 95 of it."""

    size: tuple[int, int]
    share: float
    percentiles_m: tuple[float, float, float]

    @property
    def median_m(self) -> float:
        """The median depth in metres; 0 where no pixel has depth."""
        return self.percentiles_m[1]

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for JSON, rounded."""
        return {
            "width": self.size[0],
            "height": self.size[1],
            "share_of_pixels": round(self.share, 3),
            "percentiles_m": [round(value, 2) for value in self.percentiles_m],
        }


def depth_figures(scan: Scan) -> DepthFigures | None:
    """Return what some depth images of a scan, evenly spread, hold; None for a scan without depth."""
    if not scan.has_depth:
        return None
    source = scan.depth.camera or scan.camera
    size = source.width, source.height
    step = max(1, len(scan.frames) // OPTIONS.depth_images)
    depth_m = np.concatenate([scan.depth_m(frame).ravel() for frame in scan.frames[::step]])
    known = depth_m[depth_m > 0]
    if not len(known):
        return DepthFigures(size, 0.0, (0.0, 0.0, 0.0))
    low, middle, high = np.percentile(known, [5, 50, 95]).tolist()
    return DepthFigures(size, len(known) / len(depth_m), (low, middle, high))
