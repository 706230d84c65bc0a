"""An adjustment that holds the floor's points on one level, so that neither scale nor attitude of a path can bend.

pycolmap knows no ties of points to a plane. A camera far away on the floor's level sees each of its points at its
horizon, and one whose focal length across is nothing sees no more than that. It is in the adjustment alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.structure.floor.levels import Floor
from app.engine.mapping.structure.solving import solve_in_steps
from app.limits import limit

Array = NDArray[np.float64]
# Heights of the camera between the path and the camera on the floor's level: rays to all points are parallel.
FAR = 1e4
# Pixels of focal length across: the points' places along the floor count for nothing.
NO_FOCAL_PX = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOptions:
    """How firmly the floor's points are held."""

    floor_sigma: float = limit(
        0.01,
        "Standard deviation of the height of a floor's point, in heights of the camera; it counts as much as a pixel.",
        chosen="By hand: 1.5 cm, as the points scatter.",
    )
    iterations_at_once: int = limit(
        8,
        "Iterations of the solver between two reports.",
        chosen="By hand: six seconds of a video of four minutes.",
    )
    times: int = limit(
        6, "Most times that the solver is started.", chosen="By hand: 50 iterations, as pycolmap's own."
    )


OPTIONS = HeldOptions()


def adjust_with_floor(
    colmap: Any, model: Any, options: Any, floor: Floor, report: Callable[[], None]
) -> None:
    """Adjust pycolmap's reconstruction with the floor's points on its level.

    `floor.points` are places among the points of `model`. `report` is called every few seconds; where it raises,
    nothing has changed.
    """
    # In a copy, in which the camera on the level is left.
    held = colmap.Reconstruction(model)
    ids = list(model.points3D)
    config = colmap.BundleAdjustmentConfig()
    for image_id in model.reg_image_ids():
        config.add_image(image_id)
    image_id, camera_id = _add_level(colmap, held, [ids[row] for row in floor.points], floor)
    config.add_image(image_id)
    config.set_constant_rig_from_world_pose(held.images[image_id].frame_id)
    config.set_constant_cam_intrinsics(camera_id)
    solve_in_steps(
        colmap,
        held,
        options,
        config,
        iterations_at_once=OPTIONS.iterations_at_once,
        times=OPTIONS.times,
        report=report,
    )
    _take_over(model, held)


def _add_level(colmap: Any, held: Any, point_ids: list[int], floor: Floor) -> tuple[int, int]:
    """Add the camera on the floor's level, which sees its points; return the ids of its picture and of itself."""
    camera_id, image_id = max(held.cameras) + 1, max(held.images) + 1
    focal_px = FAR / OPTIONS.floor_sigma
    held.add_camera_with_trivial_rig(
        colmap.Camera(
            model="PINHOLE", width=1, height=1, params=[NO_FOCAL_PX, focal_px, 0.0, 0.0], camera_id=camera_id
        )
    )
    image = colmap.Image(name="", camera_id=camera_id, image_id=image_id)
    # What a point's own height deviates by stays: held to the level themselves, rough points would shrink the path.
    y_px = -floor.roughness / (OPTIONS.floor_sigma * floor.height)
    image.points2D = colmap.Point2DList([colmap.Point2D(np.array([0.0, y])) for y in y_px])
    held.add_image_with_trivial_frame(image, colmap.Rigid3d(_level_from_world(floor)))
    for number, point_id in enumerate(point_ids):
        held.add_observation(point_id, colmap.TrackElement(image_id, number))
    return image_id, camera_id


def _level_from_world(floor: Floor) -> Array:
    """Return the pose (3, 4) of the camera on the level: it looks along the floor, its y axis is down."""
    along = np.linalg.svd(floor.up[None])[2][1]
    rotation = np.stack([np.cross(-floor.up, along), -floor.up, along])
    place = floor.level * floor.up - FAR * floor.height * along
    return np.column_stack([rotation, -rotation @ place])


def _take_over(model: Any, held: Any) -> None:
    """Set poses, points and cameras of a reconstruction to those of its adjusted copy."""
    for frame_id in model.reg_frame_ids():
        model.frames[frame_id].rig_from_world = held.frames[frame_id].rig_from_world
    for point_id, point in model.points3D.items():
        point.xyz = held.points3D[point_id].xyz
    for camera_id, camera in model.cameras.items():
        camera.params = held.cameras[camera_id].params
