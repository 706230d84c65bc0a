"""One anchor's answer for one phone picture: matches, relative pose, scale, place on the plan, and its accuracy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.anchors.anchor import AnchorSpec
from app.engine.anchors.features import PixelMatches
from app.engine.anchors.poi_triangulation import lengths_along_rays, reliable_sights_of
from app.engine.anchors.relative_pose import instability_deg, known_verticals, phone_beside_monitor
from app.engine.query.verification import coverage
from app.errors import DegenerateGeometryError
from app.geometry.anchor_pose import AnchorSolution, PoiSight, solve_anchor, solve_calibrated
from app.geometry.camera import Camera, tangent_of_px
from app.geometry.relative_covariance import perturbed_relative, relative_pose_covariance
from app.geometry.se3 import Pose, skew

Array = NDArray[np.float64]

# A POI may come out this far from its place: this much, and this share of its distance.
MAX_POI_ERROR_M, MAX_POI_ERROR_SHARE = 0.15, 0.06
# With so many inliers the two halves of the matches have hardly ever disagreed.
SURE_INLIERS = 400
# One sigma of the phone's direction and attitude, as a share of what the worse half differs by (measured).
SIGMA_PER_INSTABILITY = 0.5
# No feature is found better than to this angle (tangent).
MIN_SIGMA = tangent_of_px(0.35)


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorEvidence:
    """What speaks for an anchor's answer.

    `matches`, `inliers`; `coverage`, the share of the phone picture's grid cells that hold inliers;
    `region_matches`, inliers inside POI regions; `parallax_deg`, the median parallax; `poi_error_share`, how far the
    worst POI comes out from its place on the plan, over what errors of tape and plan explain; `scale_error`, how far
    (logarithm) the scales of most POIs lie from their common one, and `worst_scale_error`, the farthest, or of a map
    and what it knows; `log_scale_sigma`, one sigma of the common one; `instability_deg`, how far off direction or
    attitude are when either half of the matches decides alone; `is_upright`, whether both verticals held the pose.
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

    @property
    def inlier_ratio(self) -> float:
        """Inliers over matches."""
        return self.inliers / max(self.matches, 1)


@dataclass(frozen=True, slots=True)
class MountedCamera:
    """A calibrated camera: its pose on the plan (metres, z up) and one sigma of it."""

    plan_from_monitor: Pose
    position_sigma_m: float
    orientation_sigma_rad: float

    @property
    def down(self) -> Array:
        """Down in its axes, (3,)."""
        return np.asarray(-self.plan_from_monitor.rotation[2])


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorFix:
    """A phone's place by one anchor, and the matches that agree on it: `position_sigma_m` and
    `orientation_sigma_deg` are one sigma.

    `position_covariance` (3, 3), in square metres, is what the noise of matches and measurements makes of it;
    `unsteady_m` one sigma of what the matches' choice makes of it besides.
    """

    solution: AnchorSolution
    evidence: AnchorEvidence
    position_covariance: Array
    orientation_sigma_deg: float
    inliers: PixelMatches
    unsteady_m: float = 0.0

    @property
    def is_calibrated(self) -> bool:
        """Whether the monitoring camera's pose is from a map."""
        return self.solution.vertical == "map"

    @property
    def noise_sigma_m(self) -> float:
        """One sigma of the place on the plan by noise alone, the root mean square of the error's length."""
        return float(np.sqrt(np.trace(self.position_covariance[:2, :2])))

    @property
    def position_sigma_m(self) -> float:
        """One sigma of the place on the plan, the root mean square of the error's length."""
        return float(np.hypot(self.noise_sigma_m, self.unsteady_m))

    @property
    def full_covariance(self) -> Array:
        """The covariance (3, 3) of the place by all that makes it uncertain, in square metres."""
        return np.asarray(self.position_covariance + 0.5 * self.unsteady_m**2 * np.eye(3))


def fix_by_anchor(
    spec: AnchorSpec,
    monitor_camera: Camera,
    phone_camera: Camera,
    matches: PixelMatches,
    gravity_in_phone: Array | None,
    mounted: MountedCamera | None = None,
    down_in_monitor: Array | None = None,
) -> AnchorFix | None:
    """Return where the matches put the phone, or None when they hold no relative pose or no scale.

    With `mounted`, for a camera that was calibrated, nothing rests on the POIs but the scale, and that on what the
    map knows besides. `down_in_monitor` (3,) is the other cameras' vertical, where their pictures show it.
    """
    cameras = monitor_camera, phone_camera
    verticals = known_verticals(down_in_monitor, gravity_in_phone)
    if mounted is not None:
        verticals = known_verticals(mounted.down, gravity_in_phone, mounted.orientation_sigma_rad)
    found = phone_beside_monitor(matches, cameras, verticals)
    if found is None:
        return None
    relative = found.estimate
    inliers, phone_from_monitor = relative.inlier_mask, relative.b_from_a
    monitor_px, phone_px = matches.monitor_px[inliers], matches.phone_px[inliers]
    rays = monitor_camera.normalize(monitor_px), phone_camera.normalize(phone_px)
    lengths = lengths_along_rays(*rays, phone_from_monitor)
    sights = reliable_sights_of(spec, monitor_camera, monitor_px, lengths)
    try:
        solution = _solution(
            spec, phone_from_monitor, sights, gravity_in_phone, mounted, matches.length_m[inliers], lengths
        )
        covariance = relative_pose_covariance(*rays, phone_from_monitor, MIN_SIGMA, found.information)
    except (DegenerateGeometryError, np.linalg.LinAlgError):
        return None
    # A calibrated camera's answers have no other error as large: each is tested.
    sure_inliers = SURE_INLIERS if mounted is None else len(matches) + 1
    evidence = AnchorEvidence(
        matches=len(matches),
        inliers=int(inliers.sum()),
        coverage=coverage(phone_px, (phone_camera.width, phone_camera.height)),
        region_matches=sum(count for _, count in sights),
        parallax_deg=relative.parallax_deg,
        poi_error_share=_poi_error_share(solution, [sight for sight, _ in sights]),
        scale_error=_scale_error(solution.scale_errors),
        log_scale_sigma=solution.log_scale_sigma,
        instability_deg=instability_deg(matches, cameras, found, sure_inliers),
        worst_scale_error=_worst_scale_error(solution),
        is_upright=found.verticals is not None,
    )
    return _fix(solution, evidence, phone_from_monitor, covariance, rays, mounted, matches.take(inliers))


def _fix(
    solution: AnchorSolution,
    evidence: AnchorEvidence,
    phone_from_monitor: Pose,
    relative_covariance: Array,
    rays: tuple[Array, Array],
    mounted: MountedCamera | None,
    inliers: PixelMatches,
) -> AnchorFix:
    """Return a solution with what makes it uncertain."""
    orientation = np.trace(relative_covariance[:3, :3]) + np.trace(solution.plan_from_monitor_covariance)
    position_covariance = _position_covariance(solution, phone_from_monitor, relative_covariance, rays)
    if mounted is not None:
        position_covariance = position_covariance + mounted.position_sigma_m**2 / 3.0 * np.eye(3)
    away_m = solution.metres_per_unit * float(np.linalg.norm(phone_from_monitor.translation))
    unsteady_rad = SIGMA_PER_INSTABILITY * float(np.radians(evidence.instability_deg))
    orientation_deg = float(np.degrees(np.hypot(np.sqrt(orientation), unsteady_rad)))
    return AnchorFix(
        solution=solution,
        evidence=evidence,
        position_covariance=position_covariance,
        orientation_sigma_deg=orientation_deg,
        inliers=inliers,
        unsteady_m=unsteady_rad * away_m,
    )


def _solution(
    spec: AnchorSpec,
    phone_from_monitor: Pose,
    sights: list[tuple[PoiSight, int]],
    gravity_in_phone: Array | None,
    mounted: MountedCamera | None,
    known_lengths_m: Array,
    lengths: Array,
) -> AnchorSolution:
    pois = [sight for sight, _ in sights]
    if mounted is None:
        center = np.array([spec.x, spec.y])
        return solve_anchor(center, spec.height_m, phone_from_monitor, pois, gravity_in_phone)
    return solve_calibrated(
        mounted.plan_from_monitor,
        mounted.orientation_sigma_rad,
        phone_from_monitor,
        known_lengths_m,
        lengths,
        pois,
    )


def _scale_error(errors: Array) -> float:
    """Return what all but a minority of POIs agree within: two of two, two of three, three of four."""
    return float(np.sort(np.abs(errors))[len(errors) // 2]) if len(errors) else 0.0


def _worst_scale_error(solution: AnchorSolution) -> float:
    return max(float(np.abs(solution.scale_errors).max(initial=0.0)), solution.length_scatter)


def _poi_error_share(solution: AnchorSolution, pois: list[PoiSight]) -> float:
    if not len(solution.poi_errors_m):
        return 0.0
    allowed_m = MAX_POI_ERROR_M + MAX_POI_ERROR_SHARE * np.array([poi.distance_m for poi in pois])
    return float(np.max(solution.poi_errors_m / allowed_m))


def _position_covariance(
    solution: AnchorSolution,
    phone_from_monitor: Pose,
    relative_covariance: Array,
    rays: tuple[Array, Array],
) -> Array:
    """Return the covariance (3, 3) of the phone's position in plan axes, in square metres.

    Three independent parts: the relative pose, which moves the scale too, for it moves what is triangulated; the
    scale; and the anchor's rotation on the plan.
    """
    plan_from_monitor = solution.plan_from_monitor.rotation
    before = np.median(lengths_along_rays(*rays, phone_from_monitor))

    def position(change: Array) -> Array:
        moved = perturbed_relative(phone_from_monitor, change)
        # All lengths change alike to first order: the median's change stands for that of the POIs'.
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
