"""From the world to a floor plan: metres, pixels, headings, and positions by an anchor as in paper C."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.errors import DegenerateGeometryError, InvalidInputError
from app.geometry.alignment import OPTIONS as ALIGNMENT
from app.geometry.alignment import align_2d, rotation_2d
from app.geometry.se3 import Pose, rotation_between
from app.geometry.validation import finite_points, finite_vector, unit_vector
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanOptions:
    """What is accepted as a plan's matrix, and when the optical axis has a heading."""

    matrix_tolerance_ratio: float = limit(
        5e-3,
        "Largest difference of a given matrix from a rotation about the vertical times a scale, over the scale.",
        chosen="By hand: allows for numbers that were typed with three decimals.",
    )
    min_heading_tilt_deg: float = limit(
        1.0,
        "Least angle between the optical axis and the vertical at which the axis determines the heading.",
        chosen="By hand: nearer to the vertical its direction on the plan is mostly noise.",
    )


OPTIONS = PlanOptions()
MIN_HORIZONTAL = float(np.sin(np.radians(OPTIONS.min_heading_tilt_deg)))


@dataclass(frozen=True, slots=True)
class PlanTransform:
    """A floor's `plan_from_world` (4, 4): a rotation about the vertical, one scale, a translation.

    World and plan are right-handed, metric, z up; plan x is right and y up on the drawing. The constructor
    removes the rounding of typed numbers and raises `InvalidInputError` for any other matrix.
    """

    matrix: Array

    def __post_init__(self) -> None:
        given = np.asarray(self.matrix, dtype=np.float64)
        if given.shape != (4, 4) or not np.isfinite(given).all():
            raise InvalidInputError("plan_from_world must be a 4x4 matrix of finite numbers.")
        if not np.allclose(given[3], [0, 0, 0, 1], atol=1e-6):
            raise InvalidInputError("The last row of plan_from_world must be 0 0 0 1.")
        clean = similarity_about_vertical(given)
        clean.setflags(write=False)
        object.__setattr__(self, "matrix", clean)

    @property
    def scale(self) -> float:
        """Plan metres per world metre; 1 when both have the true size."""
        return float(self.matrix[2, 2])

    @property
    def rotation(self) -> Array:
        """The rotation (3, 3) about the vertical, without the scale."""
        return np.asarray(self.matrix[:3, :3] / self.scale)

    @property
    def yaw_deg(self) -> float:
        """The direction of world x on the plan, -180 to 180 counter-clockwise from plan x."""
        return float(np.degrees(np.arctan2(self.matrix[1, 0], self.matrix[0, 0])))

    def apply(self, points_in_world: ArrayLike) -> Array:
        """Return the points (..., 3) in plan metres of points (..., 3) in world metres."""
        points = np.asarray(points_in_world, dtype=np.float64)
        return np.asarray(points @ self.matrix[:3, :3].T + self.matrix[:3, 3])

    def apply_inverse(self, points_in_plan: ArrayLike) -> Array:
        """Return the points (..., 3) in world metres of points (..., 3) in plan metres."""
        moved = np.asarray(points_in_plan, dtype=np.float64) - self.matrix[:3, 3]
        return np.asarray(moved @ self.rotation / self.scale)


def similarity_about_vertical(matrix: Array) -> Array:
    """Return the similarity (4, 4), with a rotation about z only, of which `matrix` is a rounded copy.

    Raises `InvalidInputError` for a matrix that mirrors, tilts the vertical, or scales its axes differently.
    """
    linear = matrix[:3, :3]
    determinant = float(np.linalg.det(linear))
    if abs(determinant) < 1e-12:
        raise InvalidInputError("plan_from_world can't be inverted.")
    if determinant < 0:
        raise InvalidInputError("plan_from_world mirrors the world; give the plan with x right and y up.")
    scale = float(np.cbrt(determinant))
    cos, sin = linear[0, 0] + linear[1, 1], linear[1, 0] - linear[0, 1]
    clean = np.eye(4)
    clean[:2, :2] = scale / (np.hypot(cos, sin) or 1.0) * np.array([[cos, -sin], [sin, cos]])
    clean[2, 2] = scale
    if np.abs(clean[:3, :3] - linear).max() > OPTIONS.matrix_tolerance_ratio * scale:
        raise InvalidInputError(
            "plan_from_world must be a turn about the vertical, one scale for all three axes, and a shift."
        )
    clean[:3, 3] = matrix[:3, 3]
    return clean


class PlanFit(NamedTuple):
    """A fitted `plan_from_world` (4, 4), the root mean square of its residuals, and their lengths (n,), in metres."""

    matrix: Array
    residual_rms_m: float
    residuals_m: Array

    @property
    def scale(self) -> float:
        """Plan metres per world metre; far from 1 when plan or scan doesn't have the true size."""
        return float(self.matrix[2, 2])


def fit_plan_from_world(
    points_in_world: ArrayLike, points_in_plan: ArrayLike, *, estimate_scale: bool = True
) -> PlanFit:
    """Return the `plan_from_world` that best maps world points (n, 2 or 3) to plan points (n, 2).

    Least squares over a rotation about the vertical, a horizontal translation and, with `estimate_scale`, one scale;
    never a mirror image. Height 0 stays 0. Two different points are enough. Raises `DegenerateGeometryError`
    when all points coincide, `InvalidInputError` for numbers that are not finite. Source: Umeyama's alignment
    in two dimensions.
    """
    world = np.asarray(points_in_world, dtype=np.float64)
    columns = 3 if world.ndim == 2 and world.shape[1] == 3 else 2
    ground = finite_points(world, columns, "world points")[:, :2]
    plan = finite_points(points_in_plan, 2, "plan points")
    linear, shift = align_2d(ground, plan, with_scale=estimate_scale)
    matrix = np.eye(4)
    matrix[:2, :2], matrix[:2, 3] = linear, shift
    matrix[2, 2] = np.sqrt(np.linalg.det(linear))
    residuals = np.linalg.norm(ground @ linear.T + shift - plan, axis=1)
    return PlanFit(matrix, float(np.sqrt(np.mean(residuals**2))), residuals)


class PlanPosition(NamedTuple):
    """A point on the plan in metres, and a direction in degrees, 0 to 360 counter-clockwise from plan x."""

    x: float
    y: float
    heading_deg: float


def plan_position(plan_from_world: PlanTransform | ArrayLike, world_from_camera: Pose) -> PlanPosition:
    """Return a camera's position on the plan, in metres, and its heading, the direction of its optical axis.

    When the optical axis is within `OPTIONS.min_heading_tilt_deg` of straight down, the heading is the direction of
    the image's upper edge; of straight up, that of its lower edge. Both continue the heading of a camera that tilts
    there.
    """
    plan = (
        plan_from_world
        if isinstance(plan_from_world, PlanTransform)
        else PlanTransform(as_matrix(plan_from_world))
    )
    x, y, _ = plan.apply(world_from_camera.translation)
    direction = plan.rotation @ horizontal_axis(world_from_camera.rotation)
    heading_deg = float(np.degrees(np.arctan2(direction[1], direction[0]))) % 360.0
    # The modulo of a tiny negative heading is rounded to 360.
    return PlanPosition(float(x), float(y), 0.0 if heading_deg >= 360.0 else heading_deg)


def as_matrix(values: ArrayLike) -> Array:
    """Return values as an array of floats."""
    return np.asarray(values, dtype=np.float64)


def horizontal_axis(rotation_world_from_camera: Array) -> Array:
    """Return the camera axis (3,), in the world, whose horizontal part has the heading's direction."""
    _, down, forward = rotation_world_from_camera.T
    if np.hypot(forward[0], forward[1]) >= MIN_HORIZONTAL:
        return np.asarray(forward)
    return np.asarray(-down if forward[2] < 0 else down)


def pixels_from_plan(
    x: ArrayLike, y: ArrayLike, meters_per_pixel: float, origin_px: ArrayLike
) -> tuple[Array, Array]:
    """Return the plan image's pixels `(u, v)` of plan coordinates in metres, numbers or arrays of one shape.

    u increases with x; v decreases as y increases. `origin_px` (2,) is the pixel of plan (0, 0).
    """
    right, up = as_matrix(x), as_matrix(y)
    u0, v0 = _checked_raster(meters_per_pixel, origin_px)
    return u0 + right / meters_per_pixel, v0 - up / meters_per_pixel


def plan_from_pixels(
    u_px: ArrayLike, v_px: ArrayLike, meters_per_pixel: float, origin_px: ArrayLike
) -> tuple[Array, Array]:
    """Return the plan coordinates `(x, y)` in metres of the plan image's pixels, the inverse of `pixels_from_plan`."""
    u0, v0 = _checked_raster(meters_per_pixel, origin_px)
    return (as_matrix(u_px) - u0) * meters_per_pixel, (v0 - as_matrix(v_px)) * meters_per_pixel


def _checked_raster(meters_per_pixel: float, origin_px: ArrayLike) -> Array:
    if not (np.isfinite(meters_per_pixel) and meters_per_pixel > 0):
        raise InvalidInputError("meters_per_pixel must be a positive number.")
    return finite_vector(origin_px, 2, "origin_px")


def ground_projection(gravity_in_camera: ArrayLike | None = None) -> Array:
    """Return M_p (2, 3), which removes a vector's vertical part: camera axes to ground axes (right, forward).

    Seen from above, ground axes are right-handed like the plan's. `gravity_in_camera` (3,) is the direction
    of down in camera axes; without it down is the camera's y axis, which is true for an upright phone only.
    Raises `InvalidInputError` for a vector without direction. Source: C eq. 4.3.1, for the upright phone.
    """
    drop_y = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    if gravity_in_camera is None:
        return drop_y
    down = unit_vector(gravity_in_camera, 3, "gravity")
    return np.asarray(drop_y @ rotation_between(down, [0.0, 1.0, 0.0]))


def project_to_ground(vectors_in_camera: ArrayLike, ground_from_camera: Array) -> Array:
    """Return the ground vectors (..., 2) of vectors (..., 3) in camera axes, by M_p (2, 3) (C eq. 4.3.2)."""
    return np.asarray(as_matrix(vectors_in_camera) @ ground_from_camera.T)


def signed_angle_rad(start: ArrayLike, end: ArrayLike) -> float:
    """Return the angle, -pi to pi counter-clockwise, from direction `start` (2,) to direction `end` (2,).

    Raises `DegenerateGeometryError` for a vector of no length. Source: C eq. 4.3.3-4.3.5. The source takes the
    positive root for the sine, which makes every clockwise angle counter-clockwise, and divides the cosine by one
    of the two lengths only.
    """
    a, b = finite_vector(start, 2, "vector"), finite_vector(end, 2, "vector")
    if min(np.linalg.norm(a), np.linalg.norm(b)) < ALIGNMENT.min_spread_m:
        raise DegenerateGeometryError("A vector without length has no direction to measure an angle from.")
    return float(np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b))


def plan_from_ground_rotation(camera_to_poi_on_ground: ArrayLike, camera_to_poi_on_plan: ArrayLike) -> Array:
    """Return R_f (2, 2), the rotation from ground axes to plan axes that aligns one vector with the other.

    Both point from the monitoring camera to the POI, in any unit. Raises `DegenerateGeometryError` when one has no
    length, as for a camera straight above its POI. Source: C eq. 4.3.3-4.3.7.
    """
    return rotation_2d(signed_angle_rad(camera_to_poi_on_ground, camera_to_poi_on_plan))


def start_on_plan(
    anchor_on_plan: ArrayLike,
    anchor_in_phone: ArrayLike,
    scale: float,
    plan_from_ground: Array,
    ground_from_phone: Array,
) -> Array:
    """Return the phone's plan position (2,) in metres by a picture of the POI that the anchor sees too.

    `anchor_on_plan` (2,) is the monitoring camera on the plan in metres; `anchor_in_phone` (3,) is its centre in
    the phone's axes, in units of `scale` metres; then R_f (2, 2) and M_p (2, 3). Source: C eq. 4.3.8-4.3.9, where
    this vector is t_sm. By eq. 4.2.3, however, t_sm is the phone's centre in the monitoring camera's axes; M_p needs
    `phone_from_anchor.translation`, which is -R_sm^T t_sm.
    """
    return _moved_on_plan(anchor_on_plan, anchor_in_phone, -scale, plan_from_ground, ground_from_phone)


def odometry_on_plan(
    start: ArrayLike,
    position_in_first: ArrayLike,
    scale: float,
    plan_from_ground: Array,
    ground_from_first: Array,
) -> Array:
    """Return the phone's plan position (2,) in metres after a motion from `start` (2,).

    `position_in_first` (3,) is the phone's centre in the axes of its first frame, in units of `scale` metres; R_f and
    M_p are those of that frame. Source: C eq. 5.1.3. The source's t_k maps points of the first frame into frame k
    (eq. 5.1.1), so the centre is `first_from_k.translation`, which is -R_k^T t_k.
    """
    return _moved_on_plan(start, position_in_first, scale, plan_from_ground, ground_from_first)


def _moved_on_plan(
    origin: ArrayLike, vector: ArrayLike, factor: float, plan_from_ground: Array, ground_from_camera: Array
) -> Array:
    if not np.isfinite(factor):
        raise InvalidInputError("The scale must be a finite number.")
    step = plan_from_ground @ project_to_ground(finite_vector(vector, 3, "position"), ground_from_camera)
    return np.asarray(finite_vector(origin, 2, "plan position") + factor * step)
