"""The floor plans of a venue as a tracker without a map uses them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.anchors.anchor import AroundPlace
from app.engine.floors.floor import Floor
from app.engine.floors.model import FloorFeatures
from app.engine.floors.plan_point import floor_of
from app.engine.floors.walls import FloorWalls
from app.engine.query.placed import WORLD, PlacedPose, plan_frame
from app.geometry.plan import PlanTransform, plan_position
from app.geometry.se3 import Pose


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanFloor:
    """A floor in the frame of the poses: its walls, None where no areas are known, and the height where its plan has
    z = 0."""

    id: str
    frame_id: str
    walls: FloorWalls | None
    zero_m: float


@dataclass(frozen=True, slots=True)
class Plans:
    """The floors of a venue by id, those in the world and those that only have a plan."""

    floors: Sequence[Floor]
    by_id: Mapping[str, PlanFloor]

    @staticmethod
    def of(floors: Sequence[Floor], features: Mapping[str, FloorFeatures]) -> Plans:
        """Return the plans of floors whose features are given by the floor's id."""
        return Plans(floors, {floor.id: _plan_floor(floor, features[floor.id]) for floor in floors})

    @property
    def has_walls(self) -> bool:
        """Whether the areas of any floor are known."""
        return any(one.walls is not None for one in self.by_id.values())

    def floor_of(self, placed: PlacedPose) -> PlanFloor | None:
        """Return the floor on which a camera is placed."""
        if placed.frame_id != WORLD:
            return next((one for one in self.by_id.values() if one.frame_id == placed.frame_id), None)
        floor = floor_of(
            [one for one in self.floors if one.plan_from_world is not None], placed.frame_from_camera
        )
        return None if floor is None else self.by_id[floor.id]

    def around(
        self, seen_from: Pose, floor_id: str, *, phone_m: float, half_view_deg: float, sees_m: float
    ) -> AroundPlace:
        """Return what may be seen from around a camera's pose in the frame of the poses, lengths in its metres."""
        floor = next(one for one in self.floors if one.id == floor_id)
        plan_from_frame = np.eye(4) if floor.plan_from_world is None else floor.plan_from_world
        x, y, heading_deg = plan_position(plan_from_frame, seen_from)
        scale = PlanTransform(plan_from_frame).scale
        return AroundPlace(
            floor_id=floor_id,
            x=x,
            y=y,
            phone_m=scale * phone_m,
            heading_deg=heading_deg,
            half_view_deg=half_view_deg,
            sees_m=scale * sees_m,
        )

    def walls_in(self, frame_id: str) -> dict[str, FloorWalls | None]:
        """Return the walls of all floors whose poses are in a frame."""
        return {one.id: one.walls for one in self.by_id.values() if one.frame_id == frame_id}


def _plan_floor(floor: Floor, features: FloorFeatures) -> PlanFloor:
    if floor.plan_from_world is None:
        return PlanFloor(
            id=floor.id,
            frame_id=plan_frame(floor.id),
            walls=FloorWalls.of(features, lambda points: points),
            zero_m=0.0,
        )
    plan = PlanTransform(floor.plan_from_world)

    def in_world(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return plan.apply_inverse(np.column_stack([points, np.zeros(len(points))]))[:, :2]

    return PlanFloor(
        id=floor.id,
        frame_id=WORLD,
        walls=FloorWalls.of(features, in_world),
        zero_m=float(plan.apply_inverse(np.zeros((1, 3)))[0, 2]),
    )
