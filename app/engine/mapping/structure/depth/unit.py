"""Whether depth images can have the unit by which they were read, where nothing but they says how large things are."""

from __future__ import annotations

from dataclasses import dataclass

from app.errors import InvalidScanError
from app.importers.depth_figures import DepthFigures
from app.importers.frames import DepthFormat
from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class UnitOptions:
    """Depths that are doubted."""

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


def doubts_of_unit(measured: DepthFigures, depth: DepthFormat) -> tuple[str, ...]:
    """Return a sentence where half of the depths are nearer or farther than a sensor in a room measures, else nothing.

    Raises `InvalidScanError` where the unit was not stated either.
    """
    median_m = measured.median_m
    if measured.share == 0 or OPTIONS.near_m <= median_m < OPTIONS.far_m:
        return ()
    than = "nearer" if median_m < OPTIONS.near_m else "farther"
    by = f"half of what the depth images measure is {than} than {median_m:.2g} m by {depth.scale:g} per metre"
    if depth.is_stated:
        return (f"Check depth_scale: {by}.",)
    raise InvalidScanError(
        f"The unit of the depth images is not stated, and {by}, which is usual for this format. Give depth_scale, "
        "the units per metre: 1000 for millimetres, 5000 in TUM's own recordings."
    )
