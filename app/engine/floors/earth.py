"""Where on Earth a venue lies: from a pose in its world, or a point of a floor's plan, to WGS 84 and back."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.engine.floors.floor import Floor
from app.geometry.alignment import rotation_2d
from app.geometry.geodesy import geodetic_from_enu
from app.geometry.geopose import GeoPose, geopose_of
from app.geometry.plan import PlanTransform
from app.geometry.se3 import Pose

PlanReason = Literal["up_unknown", "scale_unknown"]
GeoPoseReason = Literal["no_origin", "up_unknown", "scale_unknown", "plan_unknown"]
# Plans of the same size differ by no more than this in what a scale of 1 would be.
SAME_SCALE = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class VenueOrigin:
    """The place on Earth of the plan of one floor, and with it of the venue's world.

    The point (0, 0) of the plan, at height 0 of the plan, lies at `latitude` and `longitude` in degrees and `height_m`
    above the ellipsoid of WGS 84. `heading_deg` is the compass bearing of the plan's y axis: its direction in degrees
    clockwise from true north, seen from above. `floor` is the floor whose plan is meant, None for the lowest.
    """

    latitude: float
    longitude: float
    height_m: float
    heading_deg: float
    floor: str | None = None

    @property
    def geodetic(self) -> tuple[float, float, float]:
        """Longitude, latitude and height, in the order of `app/geometry/geodesy.py`."""
        return self.longitude, self.latitude, self.height_m

    @property
    def enu_from_plan(self) -> NDArray[np.float64]:
        """The rotation (3, 3) from the axes of the plan to east, north and up."""
        rotation = np.eye(3)
        rotation[:2, :2] = rotation_2d(-math.radians(self.heading_deg))
        return rotation


@dataclass(frozen=True, slots=True)
class Earth:
    """A venue on Earth: its origin and its floors, lowest first."""

    origin: VenueOrigin
    floors: Sequence[Floor]

    @property
    def own_floor(self) -> Floor | None:
        """The floor whose plan the origin places, None where there is none."""
        if self.origin.floor is None:
            return self.floors[0] if self.floors else None
        return next((floor for floor in self.floors if floor.id == self.origin.floor), None)

    def geopose(self, world_from_camera: Pose) -> GeoPose | None:
        """Return where on Earth a camera is, None while the origin's floor has no `plan_from_world`."""
        own = self.own_floor
        if own is None or own.plan_from_world is None:
            return None
        plan = PlanTransform(own.plan_from_world)
        turn = self.origin.enu_from_plan
        enu_from_camera = Pose(
            turn @ plan.rotation @ world_from_camera.rotation,
            turn @ plan.apply(world_from_camera.translation),
        )
        return geopose_of(enu_from_camera, self.origin.geodetic)

    def own_from_plan(self, floor: Floor) -> NDArray[np.float64]:
        """Return the transform (4, 4) from a floor's plan to the plan of the origin's floor.

        Where `plan_from_world` of one of the two is not known, their plans are taken to lie above each other with the
        same (0, 0), as those of one indoor map do.
        """
        own = self.own_floor
        if own is None or own.plan_from_world is None or floor.plan_from_world is None or own.id == floor.id:
            return np.eye(4)
        return np.asarray(own.plan_from_world @ np.linalg.inv(floor.plan_from_world))

    def geodetic_from_plan(self, floor: Floor, points_m: ArrayLike) -> NDArray[np.float64]:
        """Return longitudes and latitudes (n, 2) in degrees of points (n, 2) of a floor's plan, at its height 0."""
        points = np.asarray(points_m, dtype=np.float64).reshape(-1, 2)
        matrix = self.own_from_plan(floor)
        in_own = points @ matrix[:2, :2].T + matrix[:2, 3]
        flat = np.column_stack([in_own, np.zeros(len(points))])
        return geodetic_from_enu(flat @ self.origin.enu_from_plan.T, self.origin.geodetic)[:, :2]

    def plan_origin(self, floor: Floor) -> dict[str, object] | None:
        """Return the member `origin` with which a floor's features in degrees are read back as plan metres; None for a
        plan of another size than that of the origin's floor, whose metres it can't express."""
        plan_from_own = np.linalg.inv(self.own_from_plan(floor))
        if abs(float(np.linalg.det(plan_from_own[:2, :2])) - 1) > SAME_SCALE:
            return None
        turn_deg = math.degrees(math.atan2(plan_from_own[1, 0], plan_from_own[0, 0]))
        x, y = (round(float(value), 6) for value in plan_from_own[:2, 3])
        return {
            "longitude": self.origin.longitude,
            "latitude": self.origin.latitude,
            # East lies as far counter-clockwise from plan x as plan y lies clockwise from north.
            "rotation_deg": round(self.origin.heading_deg + turn_deg, 9),
            "height_m": self.origin.height_m,
            "plan": [x, y],
        }


def geopose_in(
    earth: Earth | None, world_from_camera: Pose | None, *, is_located: bool, plan_reason: PlanReason | None
) -> tuple[GeoPose | None, GeoPoseReason | None]:
    """Return where on Earth an answer's camera is, or the reason why a located camera has no such pose.

    `no_origin`: the venue has none. `up_unknown` and `scale_unknown`, as `plan_reason` says: the map's z axis is not
    known to point up, or its unit to be the metre. `plan_unknown`: the pose is known on a plan alone, or the origin's
    floor has no `plan_from_world`.
    """
    if not is_located:
        return None, None
    if earth is None:
        return None, "no_origin"
    if plan_reason is not None:
        return None, plan_reason
    found = None if world_from_camera is None else earth.geopose(world_from_camera)
    return found, "plan_unknown" if found is None else None
