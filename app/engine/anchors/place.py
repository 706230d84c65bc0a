"""From an anchor's answer on the plan to a floor, a point on its drawing, and a pose in the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.engine.floors.floor import Floor
from app.engine.floors.plan_point import PlanPoint
from app.geometry.plan import PlanTransform, pixels_from_plan, plan_position
from app.geometry.se3 import Pose

# The height of a phone comes from the same solution as its place, and is no better.
HEIGHT_SLACK_M = 0.5
# A place this far off the drawing is no place in the building.
PLAN_SLACK_M = 1.0


@dataclass(frozen=True, slots=True)
class AnchorPlace:
    """A floor, the point on its plan, and the pose in the world if the floor has a `plan_from_world`."""

    floor: Floor
    plan: PlanPoint
    world_from_camera: Pose | None


def place_on_floor(floors: Sequence[Floor], floor_id: str, plan_from_phone: Pose) -> AnchorPlace | None:
    """Return the place of a phone at `plan_from_phone` (metres on the plan, z up), or None when it lies outside the
    floor: off its drawing, or above or below it."""
    floor = next((one for one in floors if one.id == floor_id), None)
    if floor is None:
        return None
    x, y, heading_deg = plan_position(np.eye(4), plan_from_phone)
    u_px = v_px = None
    if floor.plan is not None:
        u, v = pixels_from_plan(x, y, floor.plan.meters_per_pixel, floor.plan.origin_px)
        u_px, v_px = float(u), float(v)
        slack_px = PLAN_SLACK_M / floor.plan.meters_per_pixel
        inside_u = -slack_px <= u_px <= floor.plan.width_px + slack_px
        if not (inside_u and -slack_px <= v_px <= floor.plan.height_px + slack_px):
            return None
    pose = None
    if floor.plan_from_world is not None:
        pose = world_pose(PlanTransform(floor.plan_from_world), plan_from_phone)
        if not floor.z_min_m - HEIGHT_SLACK_M <= pose.translation[2] <= floor.z_max_m + HEIGHT_SLACK_M:
            return None
    return AnchorPlace(floor, PlanPoint(x=x, y=y, heading_deg=heading_deg, u_px=u_px, v_px=v_px), pose)


def world_pose(plan_from_world: PlanTransform, plan_from_camera: Pose) -> Pose:
    """Return `world_from_camera` of a camera whose pose is known on the plan."""
    return Pose(
        plan_from_world.rotation.T @ plan_from_camera.rotation,
        plan_from_world.apply_inverse(plan_from_camera.translation),
    )
