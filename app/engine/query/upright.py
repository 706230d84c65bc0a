"""Images turned upright by gravity before they are localized."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from app.engine.query.localization import Localization
from app.engine.query.localizer import Localizer
from app.engine.query.query import Query
from app.engine.query.vdm.localizer import VdmLocalizer
from app.geometry.camera import Camera
from app.geometry.focal import ApproximateCamera
from app.geometry.se3 import Pose
from app.geometry.turns import angle_to_down_deg, camera_from_turned, turned_camera, upright_turns
from app.vision.images import Rgb

# A phone that is held still knows down to a degree or two; moving it can add ten.
GRAVITY_LIMIT_DEG = 20.0


def contradicts_gravity(
    world_from_camera: Pose | None, gravity_in_camera: tuple[float, float, float] | None
) -> bool:
    """Return whether a pose in a world whose z axis points up disagrees with the measured direction of down."""
    if world_from_camera is None or gravity_in_camera is None:
        return False
    return angle_to_down_deg(world_from_camera, gravity_in_camera) > GRAVITY_LIMIT_DEG


def localize_upright(
    localizer: Localizer | VdmLocalizer,
    rgb: Rgb,
    camera: Camera | ApproximateCamera | None,
    gravity_in_camera: tuple[float, float, float] | None,
    allowed: NDArray[np.int64] | None = None,
) -> Localization:
    """Localize an image turned upright by gravity; pose and camera of the answer are those of the image as given.

    The global descriptor, and the local features of some methods, know a place only upright.
    """
    turns = None if gravity_in_camera is None else upright_turns(gravity_in_camera)
    if turns is None:
        return localizer.answer(Query.of(rgb, camera, allowed))
    upright = np.ascontiguousarray(np.rot90(rgb, turns))
    found = localizer.answer(Query.of(upright, turned_known(camera, turns), allowed, upright=True))
    pose = found.world_from_camera
    return replace(
        found,
        world_from_camera=None if pose is None else pose @ camera_from_turned(turns).inverse(),
        camera=None if found.camera is None else turned_camera(found.camera, -turns),
        # Their pixels are those of the turned image.
        inliers=found.inliers if turns % 4 == 0 else None,
    )


def turned_known(camera: Camera | ApproximateCamera | None, turns: int) -> Camera | ApproximateCamera | None:
    """Return what is known of a camera after its image was rotated by quarter turns."""
    if isinstance(camera, ApproximateCamera):
        return ApproximateCamera(turned_camera(camera.camera, turns))
    return None if camera is None else turned_camera(camera, turns)
