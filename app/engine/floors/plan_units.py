"""What the scale between a plan and the world says about their units."""

from __future__ import annotations

from dataclasses import dataclass

from app.limits import limit

# Units in a metre.
UNITS = {"millimetres": 1000.0, "centimetres": 100.0, "inches": 39.37, "feet": 3.2808}


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanUnitOptions:
    """Which scales are those of a plan and a world in metres."""

    max_scale_ratio: float = limit(
        1.25,
        "Largest factor between the sizes of plan and world.",
        chosen="By hand: scans and drawings are a few hundredths off; feet, the nearest other unit, are off by 3.3.",
    )
    unit_ratio: float = limit(
        1.12,
        "A unit is named when the scale is within this factor of it.",
        chosen="By hand: the error of scan and drawing together.",
    )
    other_unit_ratio: float = limit(
        2.0,
        "Below this factor the units are the same, and the scan or the drawing is not true to size.",
        chosen="By hand: between the errors of scans and the factor of feet.",
    )


OPTIONS = PlanUnitOptions()


def is_true_to_size(scale: float) -> bool:
    """Return whether a scale, plan metres for a metre of the world, can be that of a plan and a world in metres."""
    return 1.0 / OPTIONS.max_scale_ratio <= scale <= OPTIONS.max_scale_ratio


def is_other_unit(scale: float) -> bool:
    """Return whether a scale is too far from 1 for an error of the scan or the drawing."""
    return not 1.0 / OPTIONS.other_unit_ratio < scale < OPTIONS.other_unit_ratio


def describe_scale(scale: float, mirrored: bool = False) -> str:
    """Return the sentence that names the likely units behind a scale, and what to change.

    `mirrored` says that y of the plan points down too, as in an image.
    """
    if mirrored and scale > OPTIONS.other_unit_ratio:
        return (
            "The plan points look like pixels with v pointing down: give them in metres with y up, "
            f"x = u / {scale:.4g} and y = -v / {scale:.4g}."
        )
    if not is_other_unit(scale):
        return "Plan or scan is not true to size: check meters_per_pixel of the plan and the depth scale of the scan."
    if scale > 1:
        unit = _named(scale)
        what = "pixels" if unit is None else f"{unit}, or pixels"
        return f"The plan points look like {what}: give them in metres, divided by {scale:.4g}."
    unit = _named(1.0 / scale)
    world = "not in metres" if unit is None else f"in {unit}"
    return (
        f"Multiplied by {1.0 / scale:.4g} the plan points would be true to size: the drawing is to a reduced scale, or "
        f"the world is {world}."
    )


def _named(units_in_metre: float) -> str | None:
    """Return the name of the unit of which about as many make a metre, if there is one."""
    for name, count in UNITS.items():
        if 1.0 / OPTIONS.unit_ratio <= units_in_metre / count <= OPTIONS.unit_ratio:
            return name
    return None
