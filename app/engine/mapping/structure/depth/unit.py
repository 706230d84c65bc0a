"""Whether depth images can have the unit by which they were read, where nothing but they says how large things are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.errors import InvalidScanError
from app.importers.frames import Scan
from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class UnitOptions:
    """Depths that are doubted."""

    depth_images: int = limit(10, "Depth images that are read.", chosen="By hand: they take a second.")
    near_m: float = limit(
        0.5,
        "Median depth in metres below which the unit of the depth images is doubted.",
        chosen="By hand: rooms have about 2 m and a desk 0.7; millimetres read as TUM's 5000 per metre give 0.4 m.",
    )
    far_m: float = limit(
        8.0,
        "Median depth in metres from which on the unit is doubted.",
        chosen="By hand: sensors of phones reach 5 m, others 10 m; 5000 per metre read as millimetres give 9 m.",
    )


OPTIONS = UnitOptions()


def doubts_of_unit(scan: Scan) -> tuple[str, ...]:
    """Return a sentence where half of the depths are nearer or farther than a sensor in a room measures, else nothing.

    Raises `InvalidScanError` where the unit was not stated either.
    """
    step = max(1, len(scan.frames) // OPTIONS.depth_images)
    depth_m = np.concatenate([scan.depth_m(frame).ravel() for frame in scan.frames[::step]])
    known = depth_m[depth_m > 0]
    median_m = float(np.median(known)) if len(known) else OPTIONS.near_m
    if OPTIONS.near_m <= median_m < OPTIONS.far_m:
        return ()
    than = "nearer" if median_m < OPTIONS.near_m else "farther"
    by = f"half of what the depth images measure is {than} than {median_m:.2g} m by {scan.depth.scale:g} per metre"
    if scan.depth.is_stated:
        return (f"Check depth_scale: {by}.",)
    raise InvalidScanError(
        f"The unit of the depth images is not stated, and {by}, which is usual for this format. Give depth_scale, "
        "the units per metre: 1000 for millimetres, 5000 in TUM's own recordings."
    )
