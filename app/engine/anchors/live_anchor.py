"""Live anchors: those whose newest frame is not older than allowed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from app.engine.anchors.anchor import Anchor
from app.engine.anchors.calibration import calibration_of
from app.engine.anchors.features import AnchorFeatures
from app.engine.anchors.fix import MountedCamera
from app.engine.floors.floor import Floor
from app.engine.floors.walls import FloorWalls
from app.geometry.camera import Camera
from app.geometry.plan import PlanTransform
from app.geometry.se3 import Pose


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveAnchor:
    """A live anchor: its newest frame's name, camera and features, the pose on the plan of a calibrated camera, and the
    floor's walls in metres of its plan, None where the floor has no areas."""

    anchor: Anchor
    frame: str
    camera: Camera
    features: AnchorFeatures
    mounted: MountedCamera | None
    walls: FloorWalls | None = None


def mounted_camera(stored: dict[str, Any] | None, floor: Floor) -> MountedCamera | None:
    """Return a calibrated camera's pose on its floor's plan, None where calibration or `plan_from_world` is missing."""
    calibration = calibration_of(stored)
    if calibration is None or floor.plan_from_world is None:
        return None
    plan, pose = PlanTransform(floor.plan_from_world), calibration.world_from_camera
    return MountedCamera(
        Pose(plan.rotation @ pose.rotation, plan.apply(pose.translation)),
        calibration.position_sigma_m * plan.scale,
        float(np.radians(calibration.orientation_sigma_deg)),
    )
