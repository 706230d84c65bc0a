"""Limits on plans and features that several modules read."""

from __future__ import annotations

from dataclasses import dataclass

from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class FloorOptions:
    """How exactly the parts of a floor must fit together."""

    touch_m: float = limit(
        0.5,
        "The end of a link touches a landmark, POI or other link that is at most this far away.",
        chosen="By hand: links are drawn by hand and rounded by tools, and no two doors are this close.",
    )
    max_coordinate_m: float = limit(
        1e6,
        "Largest absolute value of a plan coordinate.",
        chosen="By hand: beyond every plan, and still exact to less than a millimetre in the arithmetic used.",
    )
    height_slack_m: float = limit(
        0.3,
        "A camera may be this far below or above the heights of a floor and still be on it.",
        chosen="By hand: heights of floors are entered to a decimetre or two, and poses have errors of centimetres.",
    )


OPTIONS = FloorOptions()
