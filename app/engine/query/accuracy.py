"""How accurate a pose in a map is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.engine.query.matches import Matches
from app.errors import DegenerateGeometryError
from app.geometry.camera import Camera
from app.geometry.covariance import pose_accuracy, pose_covariance
from app.geometry.se3 import Pose

# Eighty degrees.
MAX_TURN_COSINE = 0.17


def accuracy_in_map(
    inliers: Matches,
    keyframe_centres: NDArray[np.float64],
    camera: Camera,
    pose: Pose,
    focal_sigma: float = 0.0,
    lens_sigma: float = 0.0,
) -> tuple[float, float]:
    """Return one sigma of position in metres and orientation in degrees of a pose, by what its inliers and the
    centres (n, 3) of their keyframes tell; infinity for what they leave open."""
    across = sigma_across(inliers.sigma_m, inliers.points_in_world, keyframe_centres, pose.translation)
    return accuracy_of(
        inliers.points_px, inliers.points_in_world, across, camera, pose, focal_sigma, lens_sigma
    )


def accuracy_of(
    points_px: NDArray[np.float64],
    points_in_world: NDArray[np.float64],
    point_sigma_m: NDArray[np.float64],
    camera: Camera,
    pose: Pose,
    focal_sigma: float = 0.0,
    lens_sigma: float = 0.0,
) -> tuple[float, float]:
    """Return one sigma of position in metres and orientation in degrees of a pose by pixels (n, 2) and world points
    (n, 3) that agree with it; infinite where the points don't tell."""
    try:
        covariance = pose_covariance(
            points_px,
            points_in_world,
            camera,
            pose,
            point_sigma_m=point_sigma_m,
            focal_sigma=focal_sigma,
            lens_sigma=lens_sigma,
        )
    except DegenerateGeometryError:
        return float("inf"), 180.0
    return pose_accuracy(covariance)


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


def seen_from_one_side(
    points: NDArray[np.float64],
    keyframe_centres: NDArray[np.float32] | NDArray[np.float64],
    centre: NDArray[np.float64],
    min_cosine: float = MAX_TURN_COSINE,
) -> NDArray[np.bool_]:
    """Return which points (n, 3) a camera at `centre` (3,) sees from the side that their keyframes, at (n, 3), saw
    them from, or one keyframe at (3,): by default within `MAX_TURN_COSINE`, beyond which no feature is matched."""
    a, b = points - keyframe_centres, points - centre
    lengths = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    return np.asarray(np.einsum("ij,ij->i", a, b) > min_cosine * lengths)


def _sines(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sine of the angle between each pair of vectors (n, 3), (n, 3)."""
    lengths = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    return np.asarray(np.linalg.norm(np.cross(a, b), axis=1) / np.maximum(lengths, 1e-12))
