"""The position fix of one phone image by one anchor: relative pose, scale, pose on the plan, and its accuracy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from app.engine.anchors.anchor import AnchorSpec
from app.engine.anchors.matching import PixelMatches
from app.engine.anchors.poi_sweep import RegionDescriptors, SweptLength, sweep_region
from app.engine.anchors.poi_triangulation import lengths_along_rays, reliable_sights_of, unseen_sights
from app.engine.anchors.relative_pose import (
    PhoneBesideMonitor,
    instability_deg,
    known_verticals,
    phone_beside_monitor,
)
from app.engine.anchors.room_scale import MatchedLengths, is_above_floor, is_held, scale_of_room
from app.engine.floors.walls import FloorWalls
from app.engine.query.verification import coverage
from app.errors import DegenerateGeometryError
from app.geometry.anchor_pose import AnchorSolution, PoiSight, solve_anchor, solve_calibrated
from app.geometry.camera import Camera, tangent_of_px
from app.geometry.relative_covariance import perturbed_relative, relative_pose_covariance
from app.geometry.se3 import Pose, skew
from app.limits import limit
from app.vision.dense_descriptors import DenseDescriptors

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class FixOptions:
    """Errors of what a fix rests on, and when it needs no test of stability."""

    poi_error_m: float = limit(
        0.15,
        "Constant part of the tolerance of a POI's position by a fix.",
        chosen="By hand: errors of tape and plan.",
    )
    poi_error_ratio: float = limit(
        0.06,
        "Part of the tolerance of a POI's position that grows with its distance, divided by the distance.",
        chosen="By hand: errors of tape and plan.",
    )
    sure_inliers: int = limit(
        400,
        "Number of inliers from which the halves of the matches are not compared.",
        chosen="Measured: with as many the halves hardly ever disagreed; the command is not recorded.",
    )
    sigma_per_instability: float = limit(
        0.5,
        "Ratio of the standard deviation of direction and attitude to the difference of the worse half.",
        chosen="Measured on rendered pairs (docs/anchors.md, How it works); the command is not recorded.",
    )
    min_feature_sigma_px: float = limit(
        0.35,
        "Least standard deviation of a feature's pixel, at the reference focal length.",
        chosen="By hand: no feature is located more exactly.",
    )


OPTIONS = FixOptions()
MIN_FEATURE_SIGMA_TANGENT = tangent_of_px(OPTIONS.min_feature_sigma_px)


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorEvidence:
    """The figures by which a fix is verified.

    - `matches`, `inliers`: their numbers.
    - `coverage`: the fraction of the phone image's grid cells that hold inliers.
    - `region_matches`: the number of inliers inside POI regions.
    - `parallax_deg`: the median parallax.
    - `poi_error_share`: the largest ratio of a POI's position error on the plan to its tolerance.
    - `scale_error`: the median absolute difference between the logarithms of the POIs' scales and of the common scale
      (the larger middle one of an even number).
    - `worst_scale_error`: the largest such difference, of the POIs and of the map's distances.
    - `log_scale_sigma`: the standard deviation of the common scale's logarithm.
    - `instability_deg`: the difference between the relative pose and the poses by each half of the matches.
    - `is_upright`: whether the relative pose was estimated with both verticals.
    - `room_sigmas`: the difference between the scales by the POIs and by the room, in standard deviations.
    - `is_held`: whether the phone is at a height at which people hold one; true where the floor's height is not known.
    """

    matches: int
    inliers: int
    coverage: float
    region_matches: int
    parallax_deg: float
    poi_error_share: float
    scale_error: float
    log_scale_sigma: float
    instability_deg: float
    worst_scale_error: float = 0.0
    is_upright: bool = False
    room_sigmas: float = 0.0
    is_held: bool = True

    @property
    def inlier_ratio(self) -> float:
        """The ratio of inliers to matches."""
        return self.inliers / max(self.matches, 1)


@dataclass(frozen=True, slots=True)
class MountedCamera:
    """A calibrated camera: its pose on the plan (metres, z up) and the standard deviations of position and attitude."""

    plan_from_monitor: Pose
    position_sigma_m: float
    orientation_sigma_rad: float

    @property
    def down(self) -> Array:
        """The direction of down in camera axes, (3,)."""
        return np.asarray(-self.plan_from_monitor.rotation[2])


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorFix:
    """A phone's pose on the plan by one anchor, the inliers, and the accuracy.

    `position_covariance` (3, 3), in square metres, is that by the noise of matches and measurements.
    `instability_sigma_m` is the standard deviation of the position by the instability of the relative pose, in
    addition. `orientation_sigma_deg` is the standard deviation of the attitude.
    """

    solution: AnchorSolution
    evidence: AnchorEvidence
    position_covariance: Array
    orientation_sigma_deg: float
    inliers: PixelMatches
    instability_sigma_m: float = 0.0

    @property
    def is_calibrated(self) -> bool:
        """Whether the monitoring camera's pose is from a map."""
        return self.solution.vertical == "map"

    @property
    def noise_sigma_m(self) -> float:
        """The standard deviation of the position on the plan by noise alone, as the root mean square error."""
        return float(np.sqrt(np.trace(self.position_covariance[:2, :2])))

    @property
    def position_sigma_m(self) -> float:
        """The standard deviation of the position on the plan, as the root mean square error."""
        return float(np.hypot(self.noise_sigma_m, self.instability_sigma_m))

    @property
    def full_covariance(self) -> Array:
        """The covariance (3, 3) of the position by noise and instability, in square metres."""
        return np.asarray(self.position_covariance + 0.5 * self.instability_sigma_m**2 * np.eye(3))


def fix_by_anchor(
    spec: AnchorSpec,
    monitor_camera: Camera,
    phone_camera: Camera,
    matches: PixelMatches,
    gravity_in_phone: Array | None,
    mounted: MountedCamera | None = None,
    down_in_monitor: Array | None = None,
    dense: tuple[RegionDescriptors, DenseDescriptors] | None = None,
    walls: FloorWalls | None = None,
) -> AnchorFix | None:
    """Return the phone's fix by the matches, or None where they determine no relative pose or no scale.

    `mounted` is the pose of a calibrated camera: then only the scale rests on the POIs, together with the map's
    distances. `down_in_monitor` (3,) is the vertical of a camera that is not calibrated, where its frame shows it.
    With `dense`, the monitoring frame's regions and the phone's image, the length of a POI with few matches is found by
    a plane sweep. `walls`, in metres of the plan, give a scale where gravity is known, whether a POI is seen or not.
    """
    cameras = monitor_camera, phone_camera
    verticals = known_verticals(down_in_monitor, gravity_in_phone)
    if mounted is not None:
        verticals = known_verticals(mounted.down, gravity_in_phone, mounted.orientation_sigma_rad)
    found = phone_beside_monitor(matches, cameras, verticals)
    if found is None:
        return None
    seen = _Seen.of(matches, cameras, found)
    sweep = None if dense is None else _sweep(dense, cameras, seen.phone_from_monitor)
    sights = reliable_sights_of(spec, monitor_camera, seen.inliers.monitor_px, seen.lengths, sweep)
    pois = [sight for sight, _ in sights]
    by_room = None
    is_usable = mounted is None and gravity_in_phone is not None and is_above_floor(spec.height_m)
    if walls is not None and is_usable:
        # The phone needn't see a POI, whose ray turns the camera on the plan all the same.
        pois += unseen_sights(spec, monitor_camera, pois)
        by_room = partial(scale_of_room, seen.by_monitor, walls=walls)
    try:
        if mounted is None:
            at = np.array([spec.x, spec.y]), spec.height_m
            solution = solve_anchor(*at, seen.phone_from_monitor, pois, gravity_in_phone, by_room)
        else:
            solution = solve_calibrated(
                mounted.plan_from_monitor,
                mounted.orientation_sigma_rad,
                seen.phone_from_monitor,
                seen.inliers.length_m,
                seen.lengths,
                pois,
            )
        covariance = relative_pose_covariance(
            *seen.rays, seen.phone_from_monitor, MIN_FEATURE_SIGMA_TANGENT, found.information
        )
    except (DegenerateGeometryError, np.linalg.LinAlgError):
        return None
    evidence = _evidence(
        seen, solution, pois, sights, is_calibrated=mounted is not None, has_floor=by_room is not None
    )
    return _fix(solution, evidence, seen, covariance, mounted)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Seen:
    """What a monitoring camera and a phone both see by their relative pose: the matches, of these the inliers, their
    rays (n, 2) in both cameras, and their distances (n,) from the monitoring camera, in the unit of the pose."""

    matches: PixelMatches
    cameras: tuple[Camera, Camera]
    found: PhoneBesideMonitor
    inliers: PixelMatches
    rays: tuple[Array, Array]
    lengths: Array

    @staticmethod
    def of(matches: PixelMatches, cameras: tuple[Camera, Camera], found: PhoneBesideMonitor) -> _Seen:
        """Return what both see by a relative pose."""
        inliers = matches.take(found.estimate.inlier_mask)
        rays = cameras[0].normalize(inliers.monitor_px), cameras[1].normalize(inliers.phone_px)
        lengths = lengths_along_rays(*rays, found.estimate.b_from_a)
        return _Seen(
            matches=matches, cameras=cameras, found=found, inliers=inliers, rays=rays, lengths=lengths
        )

    @property
    def phone_from_monitor(self) -> Pose:
        return self.found.estimate.b_from_a

    @property
    def by_monitor(self) -> MatchedLengths:
        """The same as the monitoring camera has it."""
        phone_in_monitor = self.phone_from_monitor.inverse().translation
        return MatchedLengths(self.cameras[0], self.inliers.monitor_px, self.lengths, phone_in_monitor)

    def baseline_m(self, solution: AnchorSolution) -> float:
        """Return the distance of the phone from the camera by a solution, in metres."""
        return solution.metres_per_unit * float(np.linalg.norm(self.phone_from_monitor.translation))


def _evidence(
    seen: _Seen,
    solution: AnchorSolution,
    pois: list[PoiSight],
    sights: list[tuple[PoiSight, int]],
    *,
    is_calibrated: bool,
    has_floor: bool,
) -> AnchorEvidence:
    """Return the figures of a solution by `pois`, of which the phone sees those in `sights`, with their matches.

    `has_floor` says that the plan's z counts from the floor.
    """
    phone = seen.cameras[1]
    # Of a calibrated camera instability is the largest error, so that the halves are always compared.
    sure_inliers = len(seen.matches) + 1 if is_calibrated else OPTIONS.sure_inliers
    return AnchorEvidence(
        matches=len(seen.matches),
        inliers=len(seen.inliers),
        coverage=coverage(seen.inliers.phone_px, (phone.width, phone.height)),
        region_matches=sum(count for _, count in sights),
        parallax_deg=seen.found.estimate.parallax_deg,
        poi_error_share=_poi_error_share(solution, pois),
        scale_error=_scale_error(solution.scale_errors),
        log_scale_sigma=solution.log_scale_sigma,
        instability_deg=instability_deg(seen.matches, seen.cameras, seen.found, sure_inliers),
        worst_scale_error=_worst_scale_error(solution),
        is_upright=seen.found.verticals is not None,
        room_sigmas=solution.room_sigmas or 0.0,
        is_held=not has_floor or is_held(solution.plan_from_phone, seen.baseline_m(solution)),
    )


def _sweep(
    dense: tuple[RegionDescriptors, DenseDescriptors],
    cameras: tuple[Camera, Camera],
    phone_from_monitor: Pose,
) -> Callable[[Array, float], SweptLength | None]:
    """Return the sweep of a region, by its middle and size."""
    regions, phone = dense

    def sweep(middle_px: Array, size_px: float) -> SweptLength | None:
        inside = np.asarray((np.abs(regions.points_px - middle_px) <= 0.5 * size_px).all(axis=1))
        return sweep_region(regions.take(inside), middle_px, size_px, phone, cameras, phone_from_monitor)

    return sweep


def _fix(
    solution: AnchorSolution,
    evidence: AnchorEvidence,
    seen: _Seen,
    relative_covariance: Array,
    mounted: MountedCamera | None,
) -> AnchorFix:
    """Return a solution with its covariances."""
    orientation = np.trace(relative_covariance[:3, :3]) + np.trace(solution.plan_from_monitor_covariance)
    position_covariance = _position_covariance(
        solution, seen.phone_from_monitor, relative_covariance, seen.rays
    )
    if mounted is not None:
        position_covariance = position_covariance + mounted.position_sigma_m**2 / 3.0 * np.eye(3)
    unsteady_rad = OPTIONS.sigma_per_instability * float(np.radians(evidence.instability_deg))
    orientation_deg = float(np.degrees(np.hypot(np.sqrt(orientation), unsteady_rad)))
    return AnchorFix(
        solution=solution,
        evidence=evidence,
        position_covariance=position_covariance,
        orientation_sigma_deg=orientation_deg,
        inliers=seen.inliers,
        instability_sigma_m=unsteady_rad * seen.baseline_m(solution),
    )


def _scale_error(errors: Array) -> float:
    """Return the upper median of absolute scale errors: that of two of two POIs, two of three, three of four."""
    return float(np.sort(np.abs(errors))[len(errors) // 2]) if len(errors) else 0.0


def _worst_scale_error(solution: AnchorSolution) -> float:
    return max(float(np.abs(solution.scale_errors).max(initial=0.0)), solution.length_scatter)


def _poi_error_share(solution: AnchorSolution, pois: list[PoiSight]) -> float:
    if not len(solution.poi_errors_m):
        return 0.0
    allowed_m = OPTIONS.poi_error_m + OPTIONS.poi_error_ratio * np.array([poi.distance_m for poi in pois])
    return float(np.max(solution.poi_errors_m / allowed_m))


def _position_covariance(
    solution: AnchorSolution,
    phone_from_monitor: Pose,
    relative_covariance: Array,
    rays: tuple[Array, Array],
) -> Array:
    """Return the covariance (3, 3) of the phone's position in plan axes, in square metres.

    It is the sum of three independent parts: by the relative pose, which also changes the triangulated lengths and so
    the scale; by the scale; and by the anchor's rotation on the plan.
    """
    plan_from_monitor = solution.plan_from_monitor.rotation
    before = np.median(lengths_along_rays(*rays, phone_from_monitor))

    def position(change: Array) -> Array:
        moved = perturbed_relative(phone_from_monitor, change)
        # To first order all lengths change by the same factor: that of the median is taken for the POIs' lengths.
        stretch = before / np.median(lengths_along_rays(*rays, moved))
        offset = -moved.rotation.T @ moved.translation
        return np.asarray(plan_from_monitor @ (solution.metres_per_unit * stretch * offset))

    here = position(np.zeros(5))
    step = 1e-5
    jacobian = np.stack([(position(step * axis) - here) / step for axis in np.eye(5)], axis=1)
    by_turn = -skew(here)
    return np.asarray(
        jacobian @ relative_covariance @ jacobian.T
        + solution.log_scale_sigma**2 * np.outer(here, here)
        + by_turn @ solution.plan_from_monitor_covariance @ by_turn.T
    )
