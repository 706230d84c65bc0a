"""The answer to a frame of a session: where the tracked pose is on the plan, the trajectory's point, the result."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from app.engine.floors.earth import PlanReason
from app.engine.floors.floor import Floor
from app.engine.floors.plan_point import PlanPoint, floor_of, plan_point
from app.engine.maps.open_map import OpenMap
from app.engine.query.placed import plan_frame
from app.engine.tracking.memory import pose_to_json
from app.engine.tracking.state import State
from app.engine.tracking.tracked import Tracked
from app.services.locate_result import LocateResult
from app.storage.maps import MapVersion
from app.storage.sessions import Session, SessionPoint


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionResult:
    """The answer to a frame: that of /locate, the tracking state, the trajectory's last points, guidance."""

    result: LocateResult
    session: str
    frame: int
    tracking: State
    unaided_m: float
    trajectory: tuple[SessionPoint, ...]
    guidance: dict[str, Any] | None


def place_of(tracked: Tracked, floors: list[Floor]) -> tuple[Floor | None, PlanPoint | None]:
    """Return floor and point on its plan of a tracked pose in the world or on a plan."""
    placed = tracked.placed
    if placed is None:
        return None, None
    if placed.world_from_camera is not None:
        floor = floor_of(floors, placed.world_from_camera)
        return floor, None if floor is None else plan_point(floor, placed.world_from_camera)
    floor = next((floor for floor in floors if placed.frame_id == plan_frame(floor.id)), None)
    if floor is None:
        return None, None
    return floor, plan_point(replace(floor, plan_from_world=np.eye(4)), placed.frame_from_camera)


def plan_reason_of(tracked: Tracked, serving: tuple[OpenMap, MapVersion] | None) -> PlanReason | None:
    """Return why a pose in the world has no plan position, None where the map gives it one."""
    if tracked.placed is None or tracked.placed.world_from_camera is None or serving is None:
        return None
    return serving[1].plan_reason


def point_of(
    frame: int, time_s: float, tracked: Tracked, floor: Floor | None, plan: PlanPoint | None
) -> SessionPoint:
    """Return the point of the trajectory that a frame adds."""
    in_world = None if tracked.placed is None else tracked.placed.world_from_camera
    return SessionPoint(
        frame=frame,
        time_s=time_s,
        tracking=tracked.state,
        pose=pose_to_json(in_world),
        floor=None if floor is None else floor.id,
        plan=None if plan is None else [plan.x, plan.y, plan.heading_deg],
        position_m=None if tracked.accuracy is None else tracked.accuracy.position_m,
    )


def result_of(
    session: Session, tracked: Tracked, floor: Floor | None, plan: PlanPoint | None
) -> LocateResult:
    """Return the answer of `/locate` for a tracked pose, without its map version, camera and timings."""
    fix = tracked.fix
    return LocateResult(
        venue=session.venue_id,
        method=tracked.method,
        map_version=None,
        reason=tracked.reason,
        world_from_camera=None if tracked.placed is None else tracked.placed.world_from_camera,
        floor=floor,
        plan=plan,
        accuracy=tracked.accuracy,
        confidence=tracked.confidence,
        support=tracked.support,
        keyframes=() if fix is None else fix.keyframes,
        anchors=() if fix is None else fix.anchors,
        vertical=None if fix is None else fix.vertical,
    )
