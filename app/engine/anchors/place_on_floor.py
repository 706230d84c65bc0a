"""From a pose on the plan to a floor, a point on its plan image, and a pose in the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.engine.floors.floor import Floor
from app.engine.floors.plan_point import PlanPoint
from app.geometry.plan import PlanTransform, pixels_from_plan, plan_position
from app.geometry.se3 import Pose
from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorPlaceOptions:
    """How far outside of a floor a fix by an anchor may lie."""

    height_slack_m: float = limit(
        0.5,
        "Largest distance of a phone above or below the floor's heights.",
        chosen="By hand: a phone's height is estimated together with its position and is no more exact.",
    )
    plan_slack_m: float = limit(
        1.0,
        "Largest distance of a phone from the plan image.",
        chosen="By hand: a position further away is not in the building.",
    )


OPTIONS = AnchorPlaceOptions()


@dataclass(frozen=True, slots=True)
class AnchorPlace:
    """A floor, the point on its plan, and the pose in the world where the floor has a `plan_from_world`."""

    floor: Floor
    plan: PlanPoint
    world_from_camera: Pose | None


def place_on_floor(floors: Sequence[Floor], floor_id: str, plan_from_phone: Pose) -> AnchorPlace | None:
    """Return the place of a phone at `plan_from_phone` (metres on the plan, z up).

    None where it lies outside of the floor: outside of the plan image, or above or below the floor's heights.
    """
    floor = next((one for one in floors if one.id == floor_id), None)
    if floor is None:
        return None
    x, y, heading_deg = plan_position(np.eye(4), plan_from_phone)
    u_px = v_px = None
    if floor.plan is not None:
        u, v = pixels_from_plan(x, y, floor.plan.meters_per_pixel, floor.plan.origin_px)
        u_px, v_px = float(u), float(v)
        slack_px = OPTIONS.plan_slack_m / floor.plan.meters_per_pixel
        inside_u = -slack_px <= u_px <= floor.plan.width_px + slack_px
        if not (inside_u and -slack_px <= v_px <= floor.plan.height_px + slack_px):
            return None
    pose = None
    if floor.plan_from_world is not None:
        pose = world_pose(PlanTransform(floor.plan_from_world), plan_from_phone)
        lowest_m, highest_m = floor.z_min_m - OPTIONS.height_slack_m, floor.z_max_m + OPTIONS.height_slack_m
        if not lowest_m <= pose.translation[2] <= highest_m:
            return None
    return AnchorPlace(floor, PlanPoint(x=x, y=y, heading_deg=heading_deg, u_px=u_px, v_px=v_px), pose)


def world_pose(plan_from_world: PlanTransform, plan_from_camera: Pose) -> Pose:
    """Return `world_from_camera` of a camera whose pose is known on the plan."""
    return Pose(
        plan_from_world.rotation.T @ plan_from_camera.rotation,
        plan_from_world.apply_inverse(plan_from_camera.translation),
    )
