"""The scale of a relative pose by the room on the plan: what a camera sees lies on the floor, the ceiling or a wall.

A POI gives the scale only to a phone that sees it (C eq. 4.2.7). The floor and the walls are in every picture: where
the camera's pose on the plan is known but for the phone's distance, each matched pixel has a distance by the plan.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.floors.plan_distances import distances_by_plan
from app.engine.floors.walls import FloorWalls
from app.geometry.anchor_pose import GRAVITY_SIGMA_RAD, KnownScale
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.geometry.triangulation import homogeneous
from app.limits import limit

Array = NDArray[np.float64]

PAIRS = "By a script that is not kept, on phones drawn like those of `roomfix evaluate-walls --building 0`"


@dataclass(frozen=True, slots=True, kw_only=True)
class RoomScaleOptions:
    """When the room gives a scale, and how exact it is."""

    min_matches: int = limit(
        30, "Least number of triangulated matches.", chosen="By hand: half of what a relative pose needs."
    )
    min_share: float = limit(
        0.5,
        "Least share of the matches, each by its distance, that agree on the scale.",
        chosen=f"{PAIRS}: with a right relative pose at least 0.4 do, with a wrong one mostly less than 0.3.",
    )
    kernel_log: float = limit(
        0.08,
        "Difference of the logarithms of two scales at which a match counts for 0.6.",
        chosen="By hand: a triangulated length is about as exact.",
    )
    near_log: float = limit(
        0.25,
        "Largest difference of a match's scale, in logarithms, from the scale that most agree on, for it to be used.",
        chosen="By hand: three times the kernel.",
    )
    front_share: float = limit(
        0.3,
        "Share of the used matches that lie behind the wall at the scale that is taken: furniture stands before walls, "
        "and nothing behind them.",
        chosen=f"{PAIRS}: 0.5 has a bias of 2 %, 0.3 of 1 %.",
    )
    base_log_sigma: float = limit(
        0.05,
        "Standard deviation of the scale's logarithm at best.",
        chosen=f"{PAIRS}: the error of half of them is below it.",
    )
    furniture_m: float = limit(
        0.4,
        "How far things stand out from a wall, metres: divided by the distance it is a standard deviation of the "
        "scale's logarithm.",
        chosen=f"{PAIRS}, in rooms with shelves: one in a hundred is beyond 3.5 sigmas.",
    )
    phone_height_m: float = limit(
        1.5, "Height at which a phone is held above the floor, metres.", chosen="By hand: a grown-up's chest."
    )
    phone_height_sigma_m: float = limit(
        0.25,
        "Standard deviation of that height, metres.",
        chosen="By hand: children and wheelchairs are within two of them.",
    )
    height_sigmas: float = limit(
        3.0,
        "Largest difference of a phone's height, and of the room's scale from that by the height, in standard "
        "deviations.",
        chosen="By hand: the usual limit between noise and outlier.",
    )
    one_wall_sigmas: float = limit(
        1.5,
        "The same where all that is used lies on one wall, which may be a line between two areas that nobody sees.",
        chosen="By hand: grown-ups hold a phone within 0.4 m of `phone_height_m`.",
    )
    one_wall_m: float = limit(
        0.1,
        "Root mean square distance of the used points from one plane below which they lie on one wall, metres.",
        chosen="By hand: a grid cell of the walls.",
    )
    least_camera_m: float = limit(
        2.0,
        "Least height of a camera on the plan's z axis with which walls are used, metres.",
        chosen="By hand: above a phone by twice the standard deviation of its height; below, z may not count from the "
        "floor.",
    )
    most_camera_m: float = limit(
        4.5,
        "Largest height of a camera on the plan's z axis with which walls are used, metres.",
        chosen="By hand: a camera of the storey above, where the plan's z is the world's, is higher.",
    )
    steps: int = limit(
        160,
        "Number of scales that are tried.",
        chosen="By hand: 0.01 apart in the usual range of logarithms.",
    )


OPTIONS = RoomScaleOptions()


@dataclass(frozen=True, slots=True)
class MatchedLengths:
    """What a monitoring camera and a phone both see: the pixels (n, 2) in the camera's frame, their distances (n,) from
    it by triangulation, and the phone's position (3,) in the camera's axes, both in the unit of the relative pose."""

    camera: Camera
    pixels: Array
    lengths: Array
    phone_in_monitor: Array


def is_above_floor(camera_height_m: float) -> bool:
    """Whether a camera at a height on the plan's z axis hangs as cameras do above a floor at z = 0.

    Elsewhere the plan's z may count from another height, and floor and phone aren't where they are looked for.
    """
    return OPTIONS.least_camera_m <= camera_height_m <= OPTIONS.most_camera_m


def scale_of_room(seen: MatchedLengths, plan_from_monitor: Pose, walls: FloorWalls) -> KnownScale | None:
    """Return the scale at which what is seen lies where the plan has floor and walls, or None where most of it lies at
    no common scale, or the phone then isn't at a height at which people hold one. It is the mean with the scale by that
    height.

    `plan_from_monitor` is in metres on the plan, z above the floor; the camera `is_above_floor`.
    """
    usable = np.isfinite(seen.lengths) & (seen.lengths > 0)
    if np.count_nonzero(usable) < OPTIONS.min_matches:
        return None
    pixels = seen.pixels[usable]
    distances_m = distances_by_plan(pixels, seen.camera, plan_from_monitor, 0.0, walls)
    logs = np.log(distances_m / seen.lengths[usable])
    offset = plan_from_monitor.rotation @ seen.phone_in_monitor
    by_height = _scale_of_height(offset, float(plan_from_monitor.translation[2]))
    if by_height is None and not _may_be_below(offset):
        return None
    lowest, highest = _possible(by_height, OPTIONS.height_sigmas)
    scale, share = _common(logs, max(lowest, logs.min()), min(highest, logs.max()))
    if share < OPTIONS.min_share:
        return None
    near = np.abs(logs - scale) < OPTIONS.near_log
    if _is_one_wall(pixels[near], distances_m[near], seen.camera):
        lowest, highest = _possible(by_height, OPTIONS.one_wall_sigmas)
        if by_height is None or not lowest <= scale <= highest:
            return None
    by_furniture = OPTIONS.furniture_m / float(np.median(distances_m[near]))
    by_room = KnownScale(
        float(np.quantile(logs[near], OPTIONS.front_share)),
        float(np.hypot(OPTIONS.base_log_sigma, by_furniture)),
    )
    return by_room if by_height is None else _mean(by_room, by_height)


def is_held(plan_from_phone: Pose, baseline_m: float) -> bool:
    """Whether a phone, so far from a camera, is at a height above the floor at which people hold one."""
    sigma_m = float(np.hypot(OPTIONS.phone_height_sigma_m, GRAVITY_SIGMA_RAD * baseline_m))
    off_m = abs(float(plan_from_phone.translation[2]) - OPTIONS.phone_height_m)
    return off_m <= OPTIONS.height_sigmas * sigma_m


def _is_one_wall(pixels: Array, distances_m: Array, camera: Camera) -> bool:
    """Whether what is at pixels (n, 2), at distances (n,) along their rays, lies on one plane."""
    rays = homogeneous(camera.normalize(pixels))
    points = rays * (distances_m / np.linalg.norm(rays, axis=1))[:, None]
    across = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[-1]
    return bool(across / np.sqrt(len(points)) < OPTIONS.one_wall_m)


def _scale_of_height(offset: Array, camera_height_m: float) -> KnownScale | None:
    """Return the scale that has a phone at the height at which people hold one; None where it isn't below the camera.

    `offset` (3,) is the phone's from the camera, in plan axes and the unit of the relative pose.
    """
    drop = float(-offset[2])
    if drop <= 0:
        return None
    below_m = camera_height_m - OPTIONS.phone_height_m
    sigma = float(np.hypot(OPTIONS.phone_height_sigma_m / below_m, _tilt(offset) / drop))
    return KnownScale(float(np.log(below_m / drop)), sigma)


def _may_be_below(offset: Array) -> bool:
    """Whether a phone that seems to be above its camera may be below by what gravity is off."""
    return float(-offset[2]) + OPTIONS.height_sigmas * _tilt(offset) > 0


def _tilt(offset: Array) -> float:
    """Return the standard deviation of an offset's height by that of gravity."""
    return GRAVITY_SIGMA_RAD * float(np.linalg.norm(offset[:2]))


def _possible(by_height: KnownScale | None, sigmas: float) -> tuple[float, float]:
    """Return the least and largest logarithm of a scale within so many standard deviations of that by the height."""
    if by_height is None:
        return -np.inf, np.inf
    return (
        by_height.log_scale - sigmas * by_height.log_sigma,
        by_height.log_scale + sigmas * by_height.log_sigma,
    )


def _mean(one: KnownScale, other: KnownScale) -> KnownScale:
    """Return the mean of two scales by their variances."""
    weights = np.array([one.log_sigma, other.log_sigma]) ** -2.0
    log_scale = float(weights @ [one.log_scale, other.log_scale] / weights.sum())
    return KnownScale(log_scale, float(weights.sum() ** -0.5))


def _common(logs: Array, lowest: float, highest: float) -> tuple[float, float]:
    """Return the logarithm of a scale that most of those in `logs` (n,) are near to, and which share of them is."""
    if lowest > highest:
        return 0.0, 0.0
    tried = np.linspace(lowest, highest, OPTIONS.steps)
    near = np.exp(-0.5 * ((logs[:, None] - tried) / OPTIONS.kernel_log) ** 2).sum(axis=0)
    best = int(near.argmax())
    return float(tried[best]), float(near[best]) / len(logs)
