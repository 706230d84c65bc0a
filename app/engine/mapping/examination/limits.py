"""The limits that several modules of the examination share."""

from __future__ import annotations

from dataclasses import dataclass

from app.limits import limit

BY_HAND_SCORE = (
    "By hand: right scans then score up to 0.54, mistakes from 1.07 on; checked by roomfix examine-mistakes "
    "(docs/figures/examine-mistakes.md)."
)
BY_HAND_TIME = "By hand: a rolling shutter reads a picture in 15 to 30 ms, and clocks are matched no better."


@dataclass(frozen=True, slots=True, kw_only=True)
class ExaminationLimits:
    """When poses, camera and depth count as right, doubtful or wrong."""

    noise_ratio: float = limit(
        3.0,
        "An epipolar error of this many times what the matches leave under their own epipolar geometry is right.",
        chosen=BY_HAND_SCORE,
    )
    min_noise_px: float = limit(
        0.35,
        "Matches are taken to be no more exact than this, in pixels at the focal length of reference.",
        chosen=BY_HAND_SCORE,
    )
    shutter_s: float = limit(
        0.02, "The motion of the picture during this time is no error of the poses.", chosen=BY_HAND_TIME
    )


LIMITS = ExaminationLimits()
