"""Robust estimators by PoseLib."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import poselib
from numpy.typing import NDArray

from app.geometry.camera import Camera
from app.geometry.estimators.interface import (
    MIN_FUNDAMENTAL_POINTS,
    MIN_POINTS,
    AbsolutePose,
    RansacBudget,
)
from app.geometry.rigs.view import RigView
from app.geometry.se3 import Pose, quaternion_from_rotation
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseLibOptions:
    """PoseLib's own refinement."""

    steps: int = limit(
        50,
        "Largest number of steps of PoseLib's own refinement.",
        chosen="By hand: meant to be enough to converge.",
    )


OPTIONS = PoseLibOptions()


class PoseLibEstimators:
    """See `Estimators`."""

    name = "PoseLib"

    def absolute_poses(
        self,
        pixels: Array,
        points: Array,
        searches: Sequence[tuple[Camera, RansacBudget]],
        *,
        loss_scale_px: float,
        prior: Pose | None,
    ) -> list[AbsolutePose | None]:
        bundle = {"loss_type": "CAUCHY", "loss_scale": loss_scale_px, "max_iterations": OPTIONS.steps}
        asked = [(_poselib_camera(camera), _ransac_options(budget)) for camera, budget in searches]
        start = None if prior is None else _poselib_pose(prior)
        found: list[AbsolutePose | None] = []
        for camera, ransac in asked:
            pose, info = poselib.estimate_absolute_pose(pixels, points, camera, ransac, bundle, start)
            is_found = info["num_inliers"] >= MIN_POINTS
            found.append(
                AbsolutePose(Pose(pose.R, pose.t).inverse(), int(info["iterations"])) if is_found else None
            )
        return found

    def rig_pose(
        self, views: Sequence[RigView], budget: RansacBudget, *, loss_scale_px: float
    ) -> Pose | None:
        # The estimator has one limit in pixels: all views are compared at the resolution of the first.
        scales = [views[0].camera.focal_px / view.camera.focal_px for view in views]
        ransac = {
            "max_reproj_error": budget.max_error_px,
            "max_iterations": budget.max_iterations,
            "min_iterations": budget.min_iterations,
            "seed": budget.seed,
        }
        found, info = poselib.estimate_generalized_absolute_pose(
            [_scaled_px(view.points_px, scale) for view, scale in zip(views, scales, strict=True)],
            [view.points_in_world for view in views],
            [_poselib_pose(view.rig_from_camera) for view in views],
            [_scaled_camera(view.camera, scale) for view, scale in zip(views, scales, strict=True)],
            ransac,
            {"loss_type": "CAUCHY", "loss_scale": loss_scale_px, "max_iterations": OPTIONS.steps},
        )
        return None if info["num_inliers"] < MIN_POINTS else Pose(found.R, found.t).inverse()

    def relative_pose(
        self, pixels_a: Array, pixels_b: Array, cameras: tuple[Camera, Camera], budget: RansacBudget
    ) -> Pose | None:
        ransac = {
            "max_epipolar_error": budget.max_error_px,
            "max_iterations": budget.max_iterations,
            "min_iterations": budget.min_iterations,
            "seed": budget.seed,
        }
        found, info = poselib.estimate_relative_pose(
            pixels_a, pixels_b, *map(_poselib_camera, cameras), ransac, {"loss_type": "CAUCHY"}
        )
        length = float(np.linalg.norm(found.t))
        if info["num_inliers"] < MIN_FUNDAMENTAL_POINTS or not np.isfinite(length) or length < 1e-9:
            return None
        return Pose(found.R, found.t / length)

    def upright_relative_poses(self, rays_a: Array, rays_b: Array) -> tuple[Array, Array]:
        found = [
            pose
            for three_a, three_b in zip(rays_a, rays_b, strict=True)
            for pose in poselib.relpose_upright_3pt(list(three_a), list(three_b))
        ]
        if not found:
            return np.zeros(0), np.zeros((0, 3))
        halves = np.array([pose.q for pose in found])
        return 2.0 * np.arctan2(halves[:, 2], halves[:, 0]), np.array([pose.t for pose in found])


def _ransac_options(budget: RansacBudget) -> dict[str, float | bool]:
    return {
        "max_reproj_error": budget.max_error_px,
        "max_iterations": budget.max_iterations,
        "min_iterations": budget.min_iterations,
        "progressive_sampling": budget.sorted_by_quality,
        "seed": budget.seed,
    }


def _poselib_camera(camera: Camera) -> poselib.Camera:
    """Return the camera for PoseLib, which follows COLMAP's names and parameter order too."""
    return poselib.Camera(camera.model, camera.params, camera.width, camera.height)


def _poselib_pose(world_from_camera: Pose) -> poselib.CameraPose:
    camera_from_world = world_from_camera.inverse()
    x, y, z, w = quaternion_from_rotation(camera_from_world.rotation)
    pose = poselib.CameraPose()
    pose.q, pose.t = np.array([w, x, y, z]), np.array(camera_from_world.translation)
    return pose


def _scaled_px(pixels: Array, scale: float) -> Array:
    return np.asarray((pixels + 0.5) * scale - 0.5)


def _scaled_camera(camera: Camera, scale: float) -> poselib.Camera:
    fx, fy, cx, cy = camera.params[:4]
    centre_px = _scaled_px(np.array([cx, cy]), scale)
    params = (fx * scale, fy * scale, *centre_px, *camera.params[4:])
    return poselib.Camera(camera.model, params, round(camera.width * scale), round(camera.height * scale))
