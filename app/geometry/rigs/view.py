"""What one camera of a rig sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.geometry.camera import Camera
from app.geometry.reprojection import reprojection_errors_px
from app.geometry.se3 import Pose

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class RigView:
    """Pixels (n, 2) of world points (n, 3), the camera that sees them, and where it is in the rig."""

    points_px: Array
    points_in_world: Array
    camera: Camera
    rig_from_camera: Pose

    def errors_px(self, world_from_rig: Pose) -> Array:
        """Return the reprojection errors (n,) of the points with the rig at a pose."""
        pose = world_from_rig @ self.rig_from_camera
        return reprojection_errors_px(self.points_px, self.points_in_world, self.camera, pose)

    def take(self, mask: NDArray[np.bool_]) -> RigView:
        """Return the view with the points that the mask (n,) marks."""
        return RigView(self.points_px[mask], self.points_in_world[mask], self.camera, self.rig_from_camera)
