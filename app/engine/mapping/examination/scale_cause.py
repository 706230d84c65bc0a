"""Whether depth or positions have the wrong scale: geometry alone shows only their ratio."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from app.engine.mapping.examination.depth_ratio import DepthRatio
from app.engine.mapping.examination.outcome import Finding
from app.limits import limit

# Depth units per metre that recorders write.
DEPTH_SCALES = (1000.0, 5000.0, 256.0, 4000.0, 10000.0, 6553.5, 100.0, 2000.0, 512.0, 1.0)
COMMON_DEPTH_SCALES = DEPTH_SCALES[:4]
# Units per metre of positions, and their names.
POSITION_UNITS = {
    1000.0: "millimetres",
    100.0: "centimetres",
    39.3701: "inches",
    3.28084: "feet",
    10.0: "decimetres",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ScaleOptions:
    """When a ratio is wrong, and what is plausible."""

    doubtful_log: float = limit(
        0.1,
        "Logarithm of the ratio from which it is doubtful.",
        chosen="By hand: sensors are off by up to 4 %.",
    )
    wrong_log: float = limit(
        0.2,
        "Logarithm of the ratio from which it is wrong.",
        chosen="By hand: no sensor or tracking is so far off.",
    )
    mixed_share: float = limit(
        0.2,
        "Share of pairs with another ratio from which a scan has several scales, which no one factor mends.",
        chosen="By hand: false matches make less.",
    )
    sigmas: float = limit(3.0, "And it must be this many of its own sigmas.", chosen="By hand.")
    known_log: float = limit(
        0.045,
        "A known scale is one within this, or two sigmas of the ratio.",
        chosen="By hand: twice a sensor's bias.",
    )
    clear_sigma: float = limit(
        0.1, "Sigma of the ratio up to which the nearer of two known scales is clear.", chosen="By hand."
    )
    least_depth_m: float = limit(
        0.25, "The least usual depth of a scan.", chosen="By hand: sensors see no nearer."
    )
    most_depth_m: float = limit(
        9.0, "The largest usual depth of a scan.", chosen="By hand: sensors see no farther."
    )
    least_speed_m_s: float = limit(0.02, "A camera that scans moves at least so fast.", chosen="By hand.")
    most_speed_m_s: float = limit(
        3.0, "A camera that scans moves at most so fast.", chosen="By hand: a slow run."
    )


OPTIONS = ScaleOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class Scales:
    """The scales as they are read, and what shows which is plausible: the scan's speed, None without times."""

    depth_scale: float
    position_scale: float
    speed_m_s: float | None


def judge_scale(found: DepthRatio, scales: Scales) -> Finding | None:
    """Return what is wrong with the scale of depth or of positions, or None."""
    if found.apart_share >= OPTIONS.mixed_share:
        return _mixed(found)
    log = abs(float(np.log(found.ratio)))
    if log < max(OPTIONS.doubtful_log, OPTIONS.sigmas * found.sigma):
        return None
    figures = {"depth_ratio": round(found.ratio, 4), "depth_ratio_sigma": round(found.sigma, 4)}
    if log < max(OPTIONS.wrong_log, OPTIONS.sigmas * found.sigma):
        return Finding(
            code="depth_ratio",
            severity="doubtful",
            sentence=f"Depth triangulated by the poses is {found.ratio:.2f} times the sensor's: check depth_scale and "
            "the scale of the positions.",
            figures=figures,
        )
    reach = max(OPTIONS.known_log, 2 * found.sigma)
    depth = _known(scales.depth_scale / found.ratio, DEPTH_SCALES, reach)
    unit = _known(scales.position_scale * found.ratio, tuple(POSITION_UNITS), reach)
    common = bool(set(depth) & set(COMMON_DEPTH_SCALES))
    likely = _likely(found, scales, common or (bool(depth) and not unit), bool(unit))
    measured = scales.depth_scale / found.ratio
    clear = _is_clear(depth, measured, found.sigma)
    depth_scale = depth[0] if clear else _preferred(depth, measured)
    position_scale = unit[0] if unit else scales.position_scale * found.ratio
    told = (
        f"Depth triangulated by the poses is {_factor(found.ratio)} times the sensor's: "
        f"the depth is {_times(found.ratio, 'small', 'large')} for the poses, or the positions are "
        f"{_times(found.ratio, 'large', 'small')} for the depth."
    )
    by_depth: dict[str, Any] = {"depth_scale": _rounded(depth_scale)}
    by_position: dict[str, Any] = {"position_scale": _rounded(position_scale)}
    first, second = (by_depth, by_position) if likely != "positions" else (by_position, by_depth)
    words = {
        "depth": f'More likely is the depth: give "depth_scale": {by_depth["depth_scale"]:g}',
        "positions": f'More likely are the positions{_in_unit(unit)}: give "position_scale": '
        f"{by_position['position_scale']:g}",
        None: f'Give "depth_scale": {by_depth["depth_scale"]:g} or "position_scale": '
        f"{by_position['position_scale']:g}",
    }[likely]
    ((other, value),) = second.items()
    return Finding(
        code="position_scale" if likely == "positions" else "depth_scale",
        sentence=f"{told} {words}" + (f', otherwise "{other}": {value:g}.' if likely else "."),
        options=first,
        certain=clear if likely == "depth" else likely == "positions" and bool(unit),
        figures=figures,
    )


def _mixed(found: DepthRatio) -> Finding:
    return Finding(
        code="mixed_scale",
        sentence=f"The scale changes within the scan: depth triangulated by the poses is {_factor(found.ratio)} "
        f"times the sensor's, but differs by over a third in {100 * found.apart_share:.0f} % of the places that were "
        "compared. Are some of the positions or of the depth images in other units?",
        figures={"depth_ratio": round(found.ratio, 4), "apart_share": round(found.apart_share, 3)},
    )


def _known(scale: float, known: tuple[float, ...], reach: float) -> list[float]:
    """Return the known scales near one, nearest first."""
    near = [value for value in known if abs(np.log(scale / value)) < reach]
    return sorted(near, key=lambda value: abs(float(np.log(scale / value))))


def _is_clear(near: list[float], scale: float, sigma: float) -> bool:
    """Whether one known scale explains a measured one, and no other does."""
    if len(near) < 2:
        return len(near) == 1
    first, second = (abs(float(np.log(scale / value))) for value in near[:2])
    return sigma < OPTIONS.clear_sigma and first < OPTIONS.known_log and second > 3 * OPTIONS.known_log


def _preferred(near: list[float], measured: float) -> float:
    """Return the commonest of the known scales near a measured one; that one itself where there are none."""
    return min(near, key=DEPTH_SCALES.index) if near else measured


def _likely(found: DepthRatio, scales: Scales, depth_known: bool, unit_known: bool) -> str | None:
    """Return which is more likely wrong, `depth` or `positions`; None where both are as likely."""
    depth_now = OPTIONS.least_depth_m < found.depth_m < OPTIONS.most_depth_m
    depth_then = OPTIONS.least_depth_m < found.depth_m * found.ratio < OPTIONS.most_depth_m
    if depth_now != depth_then:
        return "positions" if depth_now else "depth"
    if depth_known != unit_known:
        return "depth" if depth_known else "positions"
    if scales.speed_m_s:
        walked_now = OPTIONS.least_speed_m_s < scales.speed_m_s < OPTIONS.most_speed_m_s
        walked_then = OPTIONS.least_speed_m_s < scales.speed_m_s / found.ratio < OPTIONS.most_speed_m_s
        if walked_now != walked_then:
            return "depth" if walked_now else "positions"
    return None


def _times(ratio: float, above: str, below: str) -> str:
    factor, way = (ratio, above) if ratio > 1 else (1 / ratio, below)
    return f"{_factor(factor)} times too {way}"


def _factor(factor: float) -> str:
    """Return a factor with three digits that count, as people write it: 1000, not 1e+03."""
    return f"{float(f'{factor:.3g}'):.10g}"


def _in_unit(unit: list[float]) -> str:
    return f", in {POSITION_UNITS[unit[0]]}" if unit else ""


def _rounded(value: float) -> float:
    return float(f"{value:.5g}")
