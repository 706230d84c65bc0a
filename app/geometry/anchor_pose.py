"""Where a phone is on the plan, from its pose beside a monitoring camera and the POIs that both see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from app.errors import DegenerateGeometryError
from app.geometry.covariance import SIGMA_PER_MAD
from app.geometry.se3 import Pose, rotation_between, rotation_from_vector, skew

Array = NDArray[np.float64]
Vertical = Literal["gravity", "pois", "upright", "map"]

# A tape measures a distance, and a finger a place on a plan, about that well.
PLAN_SIGMA_M, PLAN_SIGMA_SHARE = 0.05, 0.015
# How far off a phone's accelerometer is, how people hold an upright phone (roll, pitch), how cameras are mounted.
GRAVITY_SIGMA_RAD = float(np.radians(1.5))
ROLL_SIGMA_RAD, PITCH_SIGMA_RAD = float(np.radians(12.0)), float(np.radians(20.0))
MOUNT_ROLL_SIGMA_RAD = float(np.radians(12.0))
# POIs whose directions are this far apart hold the vertical between them.
MIN_POI_ANGLE_RAD = float(np.radians(15.0))
# A scale by a map needs so many lengths, and is no better than this share.
MIN_KNOWN_LENGTHS = 5
MIN_SCALE_SIGMA = 0.01
STEPS = 25
# Residuals beyond this many sigma count less and less.
ROBUST_SIGMAS = 3.0


@dataclass(frozen=True, slots=True)
class PoiSight:
    """A POI as the monitoring camera sees it.

    `ray_in_monitor` (3,) is its direction, `on_plan` (2,) its place in plan metres, `distance_m` its measured
    distance from the camera, `height_offset_m` how much higher it is, where known. `length` is its distance by
    triangulation in the unit of the relative pose, `log_sigma` one sigma of that length's logarithm.
    """

    ray_in_monitor: Array
    on_plan: Array
    distance_m: float
    length: float
    log_sigma: float
    height_offset_m: float | None = None


@dataclass(frozen=True, slots=True)
class AnchorSolution:
    """A phone on a plan.

    `plan_from_phone` holds metres on the plan and height above the floor; `metres_per_unit` is r of C eq. 4.2.7
    and `log_scale_sigma` one sigma of its logarithm; `plan_from_monitor_covariance` (3, 3) of the anchor's
    rotation (vector in plan axes, rad); `poi_errors_m` (n,) how far each POI lies from its place on the plan by
    this solution; `scale_errors` (n,) how far the logarithm of each POI's own scale is from the common one;
    `vertical` says what the vertical rests on; `length_scatter` is how far, as a logarithm, the lengths that a map
    knows scatter about their common scale (one sigma, robust).
    """

    plan_from_phone: Pose
    plan_from_monitor: Pose
    metres_per_unit: float
    log_scale_sigma: float
    plan_from_monitor_covariance: Array
    poi_errors_m: Array
    scale_errors: Array
    vertical: Vertical
    length_scatter: float = 0.0


def solve_anchor(
    monitor_on_plan: Array,
    monitor_height_m: float,
    phone_from_monitor: Pose,
    sights: Sequence[PoiSight],
    gravity_in_phone: Array | None = None,
) -> AnchorSolution:
    """Return the phone's place on the plan from all POIs at once.

    `monitor_on_plan` (2,) in plan metres; `phone_from_monitor` with a translation of any unit. The vertical is
    `gravity_in_phone` (3,), down in phone axes; without it what POIs in different directions say, and an upright
    phone as far as they don't. Raises `DegenerateGeometryError` without POIs or when one lies above or below the
    camera. Source: C eq. 4.2.7 and 4.3.1-4.3.9 as one robust least-squares problem: the rotation of the
    monitoring camera on the plan must bring each POI's ray, as long as measured, to the POI's place on the plan.
    """
    if not sights:
        raise DegenerateGeometryError("A place on the plan needs at least one POI.")
    center = np.asarray(monitor_on_plan, dtype=np.float64)
    down_in_phone = np.array([0.0, 1.0, 0.0]) if gravity_in_phone is None else _unit(gravity_in_phone)
    vertical = _vertical(sights, gravity_in_phone is not None)
    problem = _Problem(
        center, phone_from_monitor.rotation, tuple(sights), down_in_phone, gravity_in_phone is None
    )
    rotation, covariance = problem.solve()
    scale, log_sigma, scale_errors = common_scale(sights)
    plan_from_monitor = Pose(rotation, np.array([*center, monitor_height_m]))
    monitor_from_phone = phone_from_monitor.inverse()
    metric = Pose(monitor_from_phone.rotation, scale * monitor_from_phone.translation)
    errors = np.array([np.linalg.norm(problem.offset(rotation, sight)) for sight in sights])
    return AnchorSolution(
        plan_from_monitor @ metric,
        plan_from_monitor,
        scale,
        log_sigma,
        covariance,
        errors,
        scale_errors,
        vertical,
    )


def solve_calibrated(
    plan_from_monitor: Pose,
    orientation_sigma_rad: float,
    phone_from_monitor: Pose,
    known_lengths_m: Array,
    lengths: Array,
    sights: Sequence[PoiSight] = (),
) -> AnchorSolution:
    """Return the phone's place beside a monitoring camera whose pose on the plan is known.

    `known_lengths_m` (n,) are distances along the camera's rays in metres, `lengths` (n,) the same ones by
    triangulation in the unit of the relative pose: their ratios hold the scale, as the POI's in `sights` do
    (C eq. 4.2.7). The first of `scale_errors` is theirs when at least `MIN_KNOWN_LENGTHS` are known; fewer count for
    nothing. Raises `DegenerateGeometryError` when no scale is known.
    """
    usable = np.isfinite(known_lengths_m) & np.isfinite(lengths) & (lengths > 0) & (known_lengths_m > 0)
    logs = [float(np.log(sight.distance_m / sight.length)) for sight in sights]
    sigmas = [float(np.hypot(sight.log_sigma, PLAN_SIGMA_SHARE)) for sight in sights]
    scatter = 0.0
    if np.count_nonzero(usable) >= MIN_KNOWN_LENGTHS:
        by_map = np.log(known_lengths_m[usable] / lengths[usable])
        middle = float(np.median(by_map))
        scatter = SIGMA_PER_MAD * float(np.median(np.abs(by_map - middle)))
        sigma = float(np.hypot(MIN_SCALE_SIGMA, max(scatter, PLAN_SIGMA_SHARE) / np.sqrt(len(by_map))))
        logs, sigmas = [middle, *logs], [sigma, *sigmas]
    if not logs:
        raise DegenerateGeometryError("A scale needs a distance that is known.")
    scale, log_sigma, scale_errors = _common_scale(np.array(logs), np.array(sigmas))
    monitor_from_phone = phone_from_monitor.inverse()
    metric = Pose(monitor_from_phone.rotation, scale * monitor_from_phone.translation)
    return AnchorSolution(
        plan_from_monitor @ metric,
        plan_from_monitor,
        scale,
        log_sigma,
        orientation_sigma_rad**2 / 3.0 * np.eye(3),
        np.zeros(0),
        scale_errors,
        "map",
        scatter,
    )


@dataclass(frozen=True, slots=True)
class _Problem:
    """Residuals, in sigmas, of a rotation from the monitoring camera's axes to the plan's."""

    center: Array
    phone_from_monitor: Array
    sights: tuple[PoiSight, ...]
    down_in_phone: Array
    is_assumed: bool

    def solve(self) -> tuple[Array, Array]:
        rotation = self._start()
        for _ in range(STEPS):
            residuals, jacobian = self._system(rotation)
            # Cauchy weights: one POI that was moved, or mistaken, can't drag the others along.
            weights = 1.0 / (1.0 + (residuals / ROBUST_SIGMAS) ** 2)
            hessian = (jacobian * weights[:, None]).T @ jacobian
            step = -np.linalg.solve(hessian, jacobian.T @ (weights * residuals))
            rotation = rotation_from_vector(step) @ rotation
            if float(np.linalg.norm(step)) < 1e-9:
                break
        residuals, jacobian = self._system(rotation)
        return rotation, np.asarray(np.linalg.inv(jacobian.T @ jacobian), dtype=np.float64)

    def offset(self, rotation: Array, sight: PoiSight) -> Array:
        """Return where on the plan the POI comes out, relative to its place there, (2,) in metres."""
        seen = self.center + sight.distance_m * (rotation @ sight.ray_in_monitor)[:2]
        return np.asarray(seen - sight.on_plan)

    def _start(self) -> Array:
        """Return the rotation with the vertical as given or assumed and the first POIs' mean turn (C 4.3.3-4.3.7)."""
        upright = rotation_between(self.phone_from_monitor.T @ self.down_in_phone, np.array([0.0, 0.0, -1.0]))
        turn = 0j
        for sight in self.sights:
            ray, wanted = upright @ sight.ray_in_monitor, sight.on_plan - self.center
            turn += complex(*wanted) * complex(*ray[:2]).conjugate()
        if abs(turn) < 1e-9:
            raise DegenerateGeometryError(
                "The POI lies straight above or below the monitoring camera: the plan's direction is open."
            )
        return rotation_from_vector(np.array([0.0, 0.0, float(np.angle(turn))])) @ upright

    def _system(self, rotation: Array) -> tuple[Array, Array]:
        """Return the residuals (n,) and their derivative (n, 3) by a rotation vector in plan axes."""
        residuals: list[float] = []
        rows: list[Array] = []
        for sight in self.sights:
            sigma = PLAN_SIGMA_M + PLAN_SIGMA_SHARE * sight.distance_m
            arm = sight.distance_m * (rotation @ sight.ray_in_monitor)
            by_turn = -skew(arm)
            offset = self.offset(rotation, sight)
            residuals += [offset[0] / sigma, offset[1] / sigma]
            rows += [by_turn[0] / sigma, by_turn[1] / sigma]
            if sight.height_offset_m is not None:
                residuals.append((arm[2] - sight.height_offset_m) / sigma)
                rows.append(by_turn[2] / sigma)
        for axis_in_phone, sigma in self._level_axes():
            # An axis across the vertical is level: its height in the plan's axes is zero.
            axis = rotation @ self.phone_from_monitor.T @ axis_in_phone
            residuals.append(axis[2] / sigma)
            rows.append(-skew(axis)[2] / sigma)
        if self.is_assumed:
            right = rotation[:, 0]
            residuals.append(right[2] / MOUNT_ROLL_SIGMA_RAD)
            rows.append(-skew(right)[2] / MOUNT_ROLL_SIGMA_RAD)
        return np.array(residuals), np.stack(rows)

    def _level_axes(self) -> tuple[tuple[Array, float], tuple[Array, float]]:
        if self.is_assumed:
            return (np.array([1.0, 0, 0]), ROLL_SIGMA_RAD), (np.array([0, 0, 1.0]), PITCH_SIGMA_RAD)
        across = rotation_between(np.array([0.0, 1.0, 0.0]), self.down_in_phone)
        return (across[:, 0], GRAVITY_SIGMA_RAD), (across[:, 2], GRAVITY_SIGMA_RAD)


def _vertical(sights: Sequence[PoiSight], has_gravity: bool) -> Vertical:
    if has_gravity:
        return "gravity"
    rays = np.stack([sight.ray_in_monitor for sight in sights])
    widest = np.arccos(np.clip((rays @ rays.T).min(), -1.0, 1.0))
    return "pois" if widest >= MIN_POI_ANGLE_RAD else "upright"


def common_scale(sights: Sequence[PoiSight]) -> tuple[float, float, Array]:
    """Return the common scale, one sigma of its logarithm, and each POI's difference from it (C eq. 4.2.7)."""
    logs = np.log([sight.distance_m / sight.length for sight in sights])
    return _common_scale(logs, np.array([np.hypot(sight.log_sigma, PLAN_SIGMA_SHARE) for sight in sights]))


def _common_scale(logs: Array, sigmas: Array) -> tuple[float, float, Array]:
    """Return what scales with logarithms (n,) and one sigma of each, (n,), amount to, as `common_scale` does."""
    center = _weighted_median(logs, 1.0 / sigmas**2)
    for _ in range(STEPS):
        weights = 1.0 / (sigmas**2 * (1.0 + ((logs - center) / (ROBUST_SIGMAS * sigmas)) ** 2))
        center = float(weights @ logs / weights.sum())
    return float(np.exp(center)), float(1.0 / np.sqrt(np.sum(1.0 / sigmas**2))), logs - center


def _weighted_median(values: Array, weights: Array) -> float:
    order = np.argsort(values)
    return float(values[order][np.searchsorted(np.cumsum(weights[order]), 0.5 * weights.sum())])


def _unit(vector: Array) -> Array:
    values = np.asarray(vector, dtype=np.float64)
    return np.asarray(values / np.linalg.norm(values))
