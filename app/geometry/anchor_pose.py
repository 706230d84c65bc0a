"""The pose of a phone on the plan, from its pose relative to a monitoring camera and the POIs that both see."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from app.errors import DegenerateGeometryError
from app.geometry.covariance import SIGMA_PER_MAD
from app.geometry.se3 import Pose, rotation_between, rotation_from_vector, skew
from app.limits import limit

Array = NDArray[np.float64]
Vertical = Literal["gravity", "pois", "upright", "map"]


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorPoseOptions:
    """Standard deviations of what is known about a phone, a monitoring camera and its POIs."""

    plan_sigma_m: float = limit(
        0.05,
        "Standard deviation of a measured distance or of a position on the plan: its constant part.",
        chosen="By hand: a tape measure, or a point marked on a plan, is about this accurate.",
    )
    plan_sigma_ratio: float = limit(
        0.015,
        "Standard deviation of a measured distance, relative to the distance: the part that grows with it.",
        chosen="By hand: a tape measure, or a point marked on a plan, is about this accurate.",
    )
    gravity_sigma_deg: float = limit(
        1.5,
        "Standard deviation of the direction of gravity that a phone states.",
        chosen="By hand: the usual error of a phone's accelerometer.",
    )
    roll_sigma_deg: float = limit(
        12.0,
        "Standard deviation of the roll of a phone that is assumed to be upright.",
        chosen="By hand: how people hold a phone.",
    )
    pitch_sigma_deg: float = limit(
        20.0,
        "Standard deviation of the pitch of a phone that is assumed to be upright.",
        chosen="By hand: how people hold a phone.",
    )
    mount_roll_sigma_deg: float = limit(
        12.0,
        "Standard deviation of the roll of a monitoring camera when the phone gives no gravity.",
        chosen="By hand: how cameras are mounted.",
    )
    min_poi_angle_deg: float = limit(
        15.0,
        "POIs determine the vertical when two of their directions differ by at least this angle.",
        chosen="By hand: POIs in nearly one direction leave the rotation about it open.",
    )
    min_known_lengths: int = limit(
        5,
        "A scale from a map's distances needs at least this number of them.",
        chosen="By hand: the median of fewer is not robust.",
    )
    min_scale_sigma_ratio: float = limit(
        0.01,
        "Lower bound of the relative standard deviation of a scale from a map's distances.",
        chosen="By hand: the errors that all distances of a map share don't average out.",
    )
    loss_scale_sigmas: float = limit(
        3.0,
        "Scale of the Cauchy loss, in standard deviations: beyond it a residual's weight falls quickly.",
        chosen="By hand: the usual limit between noise and outlier.",
    )
    max_steps: int = limit(
        25,
        "Iterations of the robust least-squares problems.",
        chosen="By hand: meant to be enough to converge.",
    )


OPTIONS = AnchorPoseOptions()
GRAVITY_SIGMA_RAD = float(np.radians(OPTIONS.gravity_sigma_deg))
ROLL_SIGMA_RAD = float(np.radians(OPTIONS.roll_sigma_deg))
PITCH_SIGMA_RAD = float(np.radians(OPTIONS.pitch_sigma_deg))
MOUNT_ROLL_SIGMA_RAD = float(np.radians(OPTIONS.mount_roll_sigma_deg))
MIN_POI_ANGLE_RAD = float(np.radians(OPTIONS.min_poi_angle_deg))


@dataclass(frozen=True, slots=True, kw_only=True)
class PoiSight:
    """A POI as the monitoring camera sees it.

    `ray_in_monitor` (3,) is its direction, `on_plan` (2,) its position in plan metres, `distance_m` its measured
    distance from the camera, `height_offset_m` its height above the camera, where known. `length` is its distance
    by triangulation in the unit of the relative pose, `log_sigma` the standard deviation of that length's logarithm;
    None of a POI that the phone doesn't see, which gives no scale and turns the camera on the plan all the same.
    """

    ray_in_monitor: Array
    on_plan: Array
    distance_m: float
    length: float | None = None
    log_sigma: float = 0.0
    height_offset_m: float | None = None


@dataclass(frozen=True, slots=True)
class KnownScale:
    """The logarithm of a scale, metres per unit of a relative pose, and its standard deviation."""

    log_scale: float
    log_sigma: float


# Returns the scale that a room gives where a monitoring camera is at this pose on the plan, or None.
ScaleOfRoom = Callable[[Pose], KnownScale | None]


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorSolution:
    """The pose of a phone on a plan.

    `plan_from_phone` holds metres on the plan and height above the floor. `metres_per_unit` is r of C eq. 4.2.7,
    `log_scale_sigma` the standard deviation of its logarithm. `plan_from_monitor_covariance` (3, 3) is of the
    anchor's rotation (rotation vector in plan axes, rad). `poi_errors_m` (n,) is the distance of each POI from its
    position on the plan by this solution. `scale_errors` (n,) is the logarithm of each POI's own scale minus that of
    the common scale. `vertical` says what determines the vertical. `length_scatter` is a robust standard deviation
    of the logarithms of the scales that single distances of a map give. `room_sigmas` is the difference between the
    logarithms of the room's scale and of the POIs' scale in standard deviations; None where one of them is not known.
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
    room_sigmas: float | None = None


def solve_anchor(
    monitor_on_plan: Array,
    monitor_height_m: float,
    phone_from_monitor: Pose,
    sights: Sequence[PoiSight],
    gravity_in_phone: Array | None = None,
    scale_of_room: ScaleOfRoom | None = None,
) -> AnchorSolution:
    """Return the phone's pose on the plan from all POIs together.

    `monitor_on_plan` (2,) in plan metres; `phone_from_monitor` with a translation of any unit. The vertical is
    `gravity_in_phone` (3,), down in phone axes. Without it, POIs in different directions determine the vertical,
    with an upright phone as a weak prior. The scale is that of the POIs that the phone sees, and the room's. Raises
    `DegenerateGeometryError` without POIs, without a scale, or when all POIs lie straight above or below the camera.
    Source: C eq. 4.2.7 and 4.3.1-4.3.9 as one robust least-squares problem for the rotation of the monitoring camera:
    each POI's ray, scaled to the measured distance, must end at the POI's position on the plan.
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
    plan_from_monitor = Pose(rotation, np.array([*center, monitor_height_m]))
    by_pois = [_scale_of(sight) for sight in sights if sight.length is not None]
    by_room = None if scale_of_room is None else scale_of_room(plan_from_monitor)
    scale, log_sigma, scale_errors = common_scale([*by_pois, *([] if by_room is None else [by_room])])
    monitor_from_phone = phone_from_monitor.inverse()
    metric = Pose(monitor_from_phone.rotation, scale * monitor_from_phone.translation)
    errors = np.array([np.linalg.norm(problem.offset(rotation, sight)) for sight in sights])
    return AnchorSolution(
        plan_from_phone=plan_from_monitor @ metric,
        plan_from_monitor=plan_from_monitor,
        metres_per_unit=scale,
        log_scale_sigma=log_sigma,
        plan_from_monitor_covariance=covariance,
        poi_errors_m=errors,
        scale_errors=scale_errors[: len(by_pois)],
        vertical=vertical,
        room_sigmas=_apart_sigmas(by_pois, by_room),
    )


def solve_calibrated(
    plan_from_monitor: Pose,
    orientation_sigma_rad: float,
    phone_from_monitor: Pose,
    known_lengths_m: Array,
    lengths: Array,
    sights: Sequence[PoiSight] = (),
) -> AnchorSolution:
    """Return the phone's pose on the plan beside a monitoring camera whose pose on the plan is known.

    `known_lengths_m` (n,) are distances along the camera's rays in metres, `lengths` (n,) the same distances by
    triangulation in the unit of the relative pose. Their ratios give the scale, as those of the POIs in `sights`
    do (C eq. 4.2.7). They are used, and their scale error is the first of `scale_errors`, when at least
    `OPTIONS.min_known_lengths` are known. Raises `DegenerateGeometryError` when no scale is known.
    """
    usable = np.isfinite(known_lengths_m) & np.isfinite(lengths) & (lengths > 0) & (known_lengths_m > 0)
    scales = [_scale_of(sight) for sight in sights if sight.length is not None]
    scatter = 0.0
    if np.count_nonzero(usable) >= OPTIONS.min_known_lengths:
        by_map = np.log(known_lengths_m[usable] / lengths[usable])
        median = float(np.median(by_map))
        scatter = SIGMA_PER_MAD * float(np.median(np.abs(by_map - median)))
        of_mean = max(scatter, OPTIONS.plan_sigma_ratio) / np.sqrt(len(by_map))
        sigma = float(np.hypot(OPTIONS.min_scale_sigma_ratio, of_mean))
        scales = [KnownScale(median, sigma), *scales]
    scale, log_sigma, scale_errors = common_scale(scales)
    monitor_from_phone = phone_from_monitor.inverse()
    metric = Pose(monitor_from_phone.rotation, scale * monitor_from_phone.translation)
    return AnchorSolution(
        plan_from_phone=plan_from_monitor @ metric,
        plan_from_monitor=plan_from_monitor,
        metres_per_unit=scale,
        log_scale_sigma=log_sigma,
        plan_from_monitor_covariance=orientation_sigma_rad**2 / 3.0 * np.eye(3),
        poi_errors_m=np.zeros(0),
        scale_errors=scale_errors,
        vertical="map",
        length_scatter=scatter,
    )


@dataclass(frozen=True, slots=True)
class _Problem:
    """Residuals, in standard deviations, of a rotation from the monitoring camera's axes to the plan's."""

    center: Array
    phone_from_monitor: Array
    sights: tuple[PoiSight, ...]
    down_in_phone: Array
    is_assumed: bool

    def solve(self) -> tuple[Array, Array]:
        rotation = self._start()
        for _ in range(OPTIONS.max_steps):
            residuals, jacobian = self._system(rotation)
            # Cauchy weights: one POI that was moved, or confused with another, has little influence.
            weights = 1.0 / (1.0 + (residuals / OPTIONS.loss_scale_sigmas) ** 2)
            hessian = (jacobian * weights[:, None]).T @ jacobian
            step = -np.linalg.solve(hessian, jacobian.T @ (weights * residuals))
            rotation = rotation_from_vector(step) @ rotation
            if float(np.linalg.norm(step)) < 1e-9:
                break
        residuals, jacobian = self._system(rotation)
        return rotation, np.asarray(np.linalg.inv(jacobian.T @ jacobian), dtype=np.float64)

    def offset(self, rotation: Array, sight: PoiSight) -> Array:
        """Return the POI's position on the plan by a rotation minus its known position, (2,) in metres."""
        seen = self.center + sight.distance_m * (rotation @ sight.ray_in_monitor)[:2]
        return np.asarray(seen - sight.on_plan)

    def _start(self) -> Array:
        """Return the rotation with the given or assumed vertical and the mean heading of the POIs (C 4.3.3-4.3.7)."""
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
            sigma = OPTIONS.plan_sigma_m + OPTIONS.plan_sigma_ratio * sight.distance_m
            arm = sight.distance_m * (rotation @ sight.ray_in_monitor)
            by_turn = -skew(arm)
            offset = self.offset(rotation, sight)
            residuals += [offset[0] / sigma, offset[1] / sigma]
            rows += [by_turn[0] / sigma, by_turn[1] / sigma]
            if sight.height_offset_m is not None:
                residuals.append((arm[2] - sight.height_offset_m) / sigma)
                rows.append(by_turn[2] / sigma)
        for axis_in_phone, sigma in self._level_axes():
            # An axis at a right angle to the vertical is level: its z in plan axes is zero.
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


def scale_of_pois(sights: Sequence[PoiSight]) -> KnownScale | None:
    """Return the common scale of the POIs that a phone sees (C eq. 4.2.7), None where it sees none."""
    scales = [_scale_of(sight) for sight in sights if sight.length is not None]
    if not scales:
        return None
    scale, log_sigma, _ = common_scale(scales)
    return KnownScale(float(np.log(scale)), log_sigma)


def _scale_of(sight: PoiSight) -> KnownScale:
    """Return the scale by one POI (C eq. 4.2.7), with the errors of its length and of the tape."""
    assert sight.length is not None  # noqa: S101 - checked by its callers
    return KnownScale(
        float(np.log(sight.distance_m / sight.length)),
        float(np.hypot(sight.log_sigma, OPTIONS.plan_sigma_ratio)),
    )


def common_scale(scales: Sequence[KnownScale]) -> tuple[float, float, Array]:
    """Return the robust mean of scales, the standard deviation of its logarithm, and each one's error in logarithms.

    Raises `DegenerateGeometryError` without any.
    """
    if not scales:
        raise DegenerateGeometryError("A scale needs a distance that is known.")
    logs = np.array([scale.log_scale for scale in scales])
    sigmas = np.array([scale.log_sigma for scale in scales])
    center = _weighted_median(logs, 1.0 / sigmas**2)
    for _ in range(OPTIONS.max_steps):
        weights = 1.0 / (sigmas**2 * (1.0 + ((logs - center) / (OPTIONS.loss_scale_sigmas * sigmas)) ** 2))
        center = float(weights @ logs / weights.sum())
    return float(np.exp(center)), float(1.0 / np.sqrt(np.sum(1.0 / sigmas**2))), logs - center


def _apart_sigmas(by_pois: Sequence[KnownScale], by_room: KnownScale | None) -> float | None:
    """Return by how many standard deviations the scales of POIs and of a room differ, None without one of them."""
    if not by_pois or by_room is None:
        return None
    scale, log_sigma, _ = common_scale(by_pois)
    return abs(by_room.log_scale - float(np.log(scale))) / float(np.hypot(log_sigma, by_room.log_sigma))


def _weighted_median(values: Array, weights: Array) -> float:
    order = np.argsort(values)
    return float(values[order][np.searchsorted(np.cumsum(weights[order]), 0.5 * weights.sum())])


def _unit(vector: Array) -> Array:
    values = np.asarray(vector, dtype=np.float64)
    return np.asarray(values / np.linalg.norm(values))
