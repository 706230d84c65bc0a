"""What would help a picture that could not be placed: in a word each, for the one who holds the camera."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from app.engine.query.intrinsics import CameraTrust
from app.engine.query.verification import Reason
from app.limits import limit
from app.vision.images import Gray, measure_quality

Hint = Literal[
    "more_light",
    "less_light",
    "hold_still",
    "step_back",
    "turn_left",
    "turn_right",
    "tilt_up",
    "tilt_down",
    "look_elsewhere",
    "go_where_it_is_mapped",
    "send_camera",
    "check_camera",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class HintOptions:
    """When which hint is given. A hint decides nothing: it is given with a refusal only."""

    dark: float = limit(
        45.0, "Mean grey value (of 255) below which more light helps.", chosen="By hand: a room at night."
    )
    bright: float = limit(
        215.0,
        "Mean grey value (of 255) above which less light helps.",
        chosen="By hand: a picture against a window.",
    )
    min_sharpness: float = limit(
        0.008,
        "Sharpness (`measure_quality`) below which holding still helps.",
        chosen="By hand: in RedKitchen, freiburg1_rpy and a third room 95 % of the frames have more; with 15 pixels "
        "of motion blur the medians are 0.004 to 0.007.",
    )
    min_features: int = limit(
        100,
        "Local features below which the picture shows too little of the room.",
        chosen="By hand: a third of what a keyframe of a furnished room has.",
    )
    side_share: float = limit(
        0.15,
        "Distance of the inliers' centre from the picture's centre, as a share of its width or height, from "
        "which turning towards them helps.",
        chosen="By hand: the mapped part then fills one half of the picture.",
    )


OPTIONS = HintOptions()


def picture_hints(gray: Gray, feature_count: int) -> tuple[Hint, ...]:
    """Return what would make a better picture of the same view: grey image (height, width), its local features."""
    quality = measure_quality(gray)
    helps: dict[Hint, bool] = {
        "more_light": quality.brightness < OPTIONS.dark,
        "less_light": quality.brightness > OPTIONS.bright,
        "hold_still": quality.contrast > 0 and quality.sharpness < OPTIONS.min_sharpness,
        "step_back": feature_count < OPTIONS.min_features,
    }
    return tuple(hint for hint, does in helps.items() if does)


def view_hints(reason: Reason, inliers_px: NDArray[np.float64], size_px: tuple[int, int]) -> tuple[Hint, ...]:
    """Return which other view would help, by why a pose was refused and by the pixels (n, 2) that agree with it in a
    picture of `size_px` (width, height)."""
    if reason == "outside_venue":
        return ("go_where_it_is_mapped",)
    if reason == "ambiguous" or not len(inliers_px):
        return ("look_elsewhere",)
    return tuple(_towards(inliers_px, size_px)) or ("step_back",)


def camera_hints(trust: CameraTrust) -> tuple[Hint, ...]:
    """Return whether another camera may help a picture whose pose was refused."""
    return ("check_camera",) if trust in ("contradicted", "disputed") else ()


def _towards(inliers_px: NDArray[np.float64], size_px: tuple[int, int]) -> Iterator[Hint]:
    """Yield where to turn so that what was recognised is in the middle of the picture."""
    right, down = np.median(inliers_px, axis=0) / np.array(size_px) - 0.5
    if abs(right) > OPTIONS.side_share:
        yield "turn_right" if right > 0 else "turn_left"
    if abs(down) > OPTIONS.side_share:
        yield "tilt_down" if down > 0 else "tilt_up"
