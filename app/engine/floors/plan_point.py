"""Which floor a pose is on, and where on its plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from app.engine.floors.floor import Floor
from app.engine.floors.options import OPTIONS
from app.geometry.plan import pixels_from_plan, plan_position
from app.geometry.se3 import Pose


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanPoint:
    """A point on a floor's plan: metres, a heading in degrees counter-clockwise from plan x, and the pixel of the plan
    image, None without an image.

    `area` and `nearest_landmark` are ids; they are None until the floor's features were looked up.
    """

    x: float
    y: float
    heading_deg: float
    u_px: float | None
    v_px: float | None
    area: str | None = None
    area_name: str | None = None
    nearest_landmark: str | None = None
    nearest_landmark_name: str | None = None
    nearest_landmark_m: float | None = None


def floor_of(floors: Sequence[Floor], world_from_camera: Pose) -> Floor | None:
    """Return the floor whose heights hold the camera, else the nearest one within the slack, else None."""
    z = float(world_from_camera.translation[2])

    def outside_m(floor: Floor) -> float:
        return max(floor.z_min_m - z, z - floor.z_max_m, 0.0)

    best = min(floors, key=outside_m, default=None)
    return best if best is not None and outside_m(best) <= OPTIONS.height_slack_m else None


def plan_point(floor: Floor, world_from_camera: Pose) -> PlanPoint | None:
    """Return where a camera is on a floor's plan, or None for a floor without `plan_from_world`."""
    if floor.plan_from_world is None:
        return None
    x, y, heading_deg = plan_position(floor.plan_from_world, world_from_camera)
    u_px = v_px = None
    if floor.plan is not None:
        u, v = pixels_from_plan(x, y, floor.plan.meters_per_pixel, floor.plan.origin_px)
        u_px, v_px = float(u), float(v)
    return PlanPoint(x=x, y=y, heading_deg=heading_deg, u_px=u_px, v_px=v_px)
