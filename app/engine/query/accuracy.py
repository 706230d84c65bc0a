"""How accurate a pose in a map is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.artifact import MapArtifact
from app.engine.query.matches import Matches
from app.engine.query.placed import Accuracy
from app.errors import DegenerateGeometryError
from app.geometry.camera import Camera
from app.geometry.covariance import pose_accuracy, pose_covariance
from app.geometry.se3 import Pose


def accuracy_in_map(
    artifact: MapArtifact,
    inliers: Matches,
    camera: Camera,
    pose: Pose,
    focal_sigma: float = 0.0,
    lens_sigma: float = 0.0,
    centre_sigma_px: float = 0.0,
) -> Accuracy:
    """Return how accurate a pose is by its inliers and the places of their keyframes; infinity for what they leave
    open. The sigmas are those of the camera's focal length (relative), lens coefficient and principal point."""
    centres = artifact.arrays.positions[inliers.keyframes]
    across = sigma_across(inliers.sigma_m, inliers.points_in_world, centres, pose.translation)
    sigmas = focal_sigma, lens_sigma, centre_sigma_px
    return accuracy_of(inliers.points_px, inliers.points_in_world, across, camera, pose, *sigmas)


def accuracy_of(
    points_px: NDArray[np.float64],
    points_in_world: NDArray[np.float64],
    point_sigma_m: NDArray[np.float64],
    camera: Camera,
    pose: Pose,
    focal_sigma: float = 0.0,
    lens_sigma: float = 0.0,
    centre_sigma_px: float = 0.0,
) -> Accuracy:
    """Return how accurate a pose is by pixels (n, 2) and world points (n, 3) that agree with it, whose noise is
    `point_sigma_m` (n,); infinite where the points don't determine it."""
    try:
        covariance = pose_covariance(
            points_px,
            points_in_world,
            camera,
            pose,
            point_sigma_m=point_sigma_m,
            focal_sigma=focal_sigma,
            lens_sigma=lens_sigma,
            centre_sigma_px=centre_sigma_px,
        )
    except DegenerateGeometryError:
        return Accuracy(float("inf"), 180.0)
    return Accuracy(*pose_accuracy(covariance))


def sigma_across(
    sigma_m: NDArray[np.floating],
    points: NDArray[np.float64],
    keyframe_centres: NDArray[np.float64],
    centre: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the noise (n,) in metres of points (n, 3) as a camera at `centre` (3,) sees it, from that along the rays
    of their keyframes at (n, 3) or (3,).

    A point is uncertain along its keyframe's ray, which a camera beside the keyframe hardly sees: what counts is
    the part of it across the camera's own ray.
    """
    return np.asarray(sigma_m * _sines(points - keyframe_centres, points - centre))


def _sines(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sine of the angle between each pair of vectors (n, 3), (n, 3)."""
    lengths = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    return np.asarray(np.linalg.norm(np.cross(a, b), axis=1) / np.maximum(lengths, 1e-12))
