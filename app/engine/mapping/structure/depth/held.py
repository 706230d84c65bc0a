"""An adjustment that holds the points of a path at the depths that a sensor measured.

Colour alone leaves the scale of each stretch of a path nearly open where the camera moves little: it drifts, and the
path bends with it. pycolmap knows no depths. A camera far to the right of a picture's own, whose focal length is as
much shorter as it is further away, sees of a point its inverse depth and nothing else. It is in the adjustment alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.structure.depth.measured import DepthOf, depth_ratios
from app.engine.mapping.structure.reconstruction import (
    HALF_PX,
    Reconstruction,
    camera_of,
    mapping_options,
    pose_of,
    start_camera,
)
from app.engine.mapping.structure.solving import solve_in_steps
from app.geometry.camera import Camera
from app.geometry.depth import sample_depth
from app.geometry.se3 import Pose
from app.limits import limit

Array = NDArray[np.float64]
# Metres between a picture's camera and the one that sees inverse depths.
FAR_M = 1e4
# Pixels of focal length down: the points' places across count for nothing.
NO_FOCAL_PX = 1e-9
STAGE = "hold_to_depth"
# The cameras' numbers.
COLOUR = 1
DEPTH = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthOptions:
    """How firmly the points are held."""

    pixel_metres: float = limit(
        10.0,
        "A difference of inverse depths of 1 / m times this counts as so many pixels.",
        chosen="roomfix evaluate-unposed, colour and depth, on redkitchen and desk_rs: of 4, 10, 25, 60, 250 the one "
        "whose queries are nearest in the first; in the second 25 and 60 are by 1 mm better. At 1 m an error of 10 cm "
        "counts as a pixel: thousands of depths hold a path all the same, and a sensor's own bend does not.",
    )
    min_depths: int = limit(
        100, "Features with a measured depth that this needs.", chosen="By hand: as many as a scale."
    )
    min_cost_change_ratio: float = limit(
        1e-5,
        "The adjustment stops where a step changes the sum of squared errors by a smaller ratio.",
        chosen="By hand: on 191 rendered pictures the path moves by 0.1 mm after that, and by 0.5 mm after 1e-4.",
    )
    iterations_at_once: int = limit(
        3,
        "Iterations of the solver between two reports.",
        chosen="By hand: some ten seconds of a scan of 700 chosen pictures.",
    )
    times: int = limit(
        16, "Most times that the solver is started.", chosen="By hand: 50 iterations, as pycolmap's own."
    )
    loss_px: float = limit(
        2.0,
        "Error from which on features and depths count for less and less (Cauchy's loss).",
        chosen="By hand: wrong matches, and depths at edges.",
    )


OPTIONS = DepthOptions()


def held_to_depth(
    part: Reconstruction,
    keypoints_px: Sequence[NDArray[np.floating]],
    depth_of: DepthOf,
    camera: Camera,
    *,
    is_calibrated: bool,
    report: Callable[[], None],
) -> Reconstruction:
    """Return a part in metres with its points at their measured depths; as it is where too few depths are measured or
    that leads to no camera.

    `keypoints_px` (n, 2) are those of each picture. `camera` is what the reconstruction started from, and
    `is_calibrated` which of its numbers are kept, as in `reconstruct`. `report` is called every few seconds.
    """
    import pycolmap

    part = _tied(part)
    measured = depth_ratios(part, depth_of)
    if len(measured.ratios) < OPTIONS.min_depths:
        return part
    model = pycolmap.Reconstruction()
    _add_cameras(pycolmap, model, part.camera, camera, is_calibrated)
    for number, point in enumerate(part.points, 1):
        model.add_point3D_with_id(number, pycolmap.Point3D(xyz=measured.metres_per_unit * point))
    for row, pose in part.poses.items():
        seen = part.observations[part.observations[:, 0] == row]
        placed = Pose(pose.rotation, measured.metres_per_unit * pose.translation)
        _add_picture(pycolmap, model, row, placed, keypoints_px[row][seen[:, 1]], seen[:, 2] + 1, depth_of)
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in model.reg_image_ids():
        config.add_image(image_id)
    config.set_constant_cam_intrinsics(DEPTH)
    config.set_constant_sensor_from_rig_pose(model.cameras[DEPTH].sensor_id)
    solve_in_steps(
        pycolmap,
        model,
        _options(pycolmap, camera, is_calibrated),
        config,
        iterations_at_once=OPTIONS.iterations_at_once,
        times=OPTIONS.times,
        report=report,
    )
    return _with_errors(_adjusted(model, part, camera), keypoints_px)


def _tied(part: Reconstruction) -> Reconstruction:
    """Return a part without the points that a single picture sees, which nothing ties."""
    counts = np.bincount(part.observations[:, 2], minlength=len(part.points))
    if (counts > 1).all():
        return part
    rows = np.cumsum(counts > 1) - 1
    kept = part.observations[counts[part.observations[:, 2]] > 1]
    observations = np.column_stack([kept[:, :2], rows[kept[:, 2]]])
    return replace(part, points=part.points[counts > 1], observations=observations)


def _add_cameras(colmap: Any, model: Any, found: Camera, camera: Camera, is_calibrated: bool) -> None:
    """Add the pictures' camera, and the one of inverse depths at its fixed place beside it."""
    colour = start_camera(colmap, camera, is_calibrated)
    if colour.model.name == "SIMPLE_RADIAL":
        _, _, cx, cy, *lens = found.params
        colour.params = [found.focal_px, cx + HALF_PX, cy + HALF_PX, *(lens[:1] or [0.0])]
    colour.camera_id = COLOUR
    focal_px = OPTIONS.pixel_metres / FAR_M
    depth = colmap.Camera(
        model="PINHOLE", width=1, height=1, params=[focal_px, NO_FOCAL_PX, 0.0, 0.0], camera_id=DEPTH
    )
    rig = colmap.Rig(rig_id=1)
    rig.add_ref_sensor(colour.sensor_id)
    rig.add_sensor(depth.sensor_id, colmap.Rigid3d(np.column_stack([np.eye(3), [-FAR_M, 0.0, 0.0]])))
    model.add_camera(colour)
    model.add_camera(depth)
    model.add_rig(rig)


def _add_picture(
    colmap: Any,
    model: Any,
    row: int,
    pose: Pose,
    pixels: NDArray[np.floating],
    point_ids: NDArray[np.intp],
    depth_of: DepthOf,
) -> None:
    """Add a picture that sees points at pixels (n, 2), and their inverse depths where they were measured."""
    depth_m = np.asarray(sample_depth(depth_of(row), pixels), np.float64)
    measured = depth_m > 0
    shift_px = -OPTIONS.pixel_metres / depth_m[measured]
    seen = (
        (COLOUR, row * 2 + 1, pixels + HALF_PX, point_ids),
        (DEPTH, row * 2 + 2, np.column_stack([shift_px, np.zeros_like(shift_px)]), point_ids[measured]),
    )
    frame = colmap.Frame(frame_id=row + 1, rig_id=1, rig_from_world=colmap.Rigid3d(pose.inverse().matrix[:3]))
    images = []
    for camera_id, image_id, places, _ in seen:
        name = str(row) if camera_id == COLOUR else ""
        image = colmap.Image(name=name, camera_id=camera_id, image_id=image_id, frame_id=frame.frame_id)
        image.points2D = colmap.Point2DList([colmap.Point2D(place) for place in places.astype(np.float64)])
        frame.add_data_id(image.data_id)
        images.append(image)
    model.add_frame(frame)
    for image in images:
        model.add_image(image)
    model.register_frame(frame.frame_id)
    for _, image_id, _, ids in seen:
        for number, point_id in enumerate(ids):
            model.add_observation(int(point_id), colmap.TrackElement(image_id, number))


def _options(colmap: Any, camera: Camera, is_calibrated: bool) -> Any:
    options = mapping_options(colmap, camera, is_calibrated).get_global_bundle_adjustment()
    options.ceres.solver_options.function_tolerance = OPTIONS.min_cost_change_ratio
    options.refine_sensor_from_rig = False
    options.ceres.loss_function_type = colmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = OPTIONS.loss_px
    return options


def _adjusted(model: Any, part: Reconstruction, started_from: Camera) -> Reconstruction:
    camera = camera_of(model.cameras[COLOUR], started_from)
    if camera is None:
        return part
    poses = {int(image.name): pose_of(image) for image in model.images.values() if image.name}
    points = np.array([model.points3D[number].xyz for number in range(1, len(part.points) + 1)])
    return replace(part, camera=camera, poses=dict(sorted(poses.items())), points=points)


def _with_errors(part: Reconstruction, keypoints_px: Sequence[NDArray[np.floating]]) -> Reconstruction:
    """Return a part with the mean reprojection error of its features, without those that lead to nowhere."""
    errors = []
    for row, pose in part.poses.items():
        _, features, points = part.observations[part.observations[:, 0] == row].T
        pixels = part.camera.project(pose.inverse().apply(part.points[points]))
        errors.append(np.linalg.norm(pixels - keypoints_px[row][features], axis=1))
    return replace(part, error_px=float(np.nanmean(np.concatenate(errors))))
