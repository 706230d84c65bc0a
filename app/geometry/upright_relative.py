"""The relative pose of two cameras whose verticals are known, by RANSAC with three-point samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.geometry.camera import Camera
from app.geometry.epipolar import OPTIONS as EPIPOLAR
from app.geometry.epipolar import (
    RelativePoseEstimate,
    in_front_of_both,
    relative_estimate,
)
from app.geometry.estimators.chosen import ESTIMATORS
from app.geometry.estimators.interface import MIN_FUNDAMENTAL_POINTS
from app.geometry.estimators.relative_refinement import KnownVerticals, RelativePoseProblem
from app.geometry.se3 import Pose, rotation_between
from app.geometry.triangulation import homogeneous, unit_rays
from app.geometry.validation import finite_pairs
from app.limits import limit

Array = NDArray[np.float64]

# The solver has its vertical along y.
DOWN = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True, slots=True, kw_only=True)
class UprightOptions:
    """How samples are ranked, and how the best of them are refined."""

    samples: int = limit(
        300,
        "RANSAC samples of three matches.",
        chosen="By hand: a sample of three matches is free of outliers much more often than one of five.",
    )
    sample_error_ratio: float = limit(
        2.0,
        "Error at which a match supports a sample's pose no more, over the largest error of an inlier.",
        chosen="By hand: a sample's pose has the errors of its three matches and of the verticals.",
    )
    refined_poses: int = limit(
        3,
        "Poses with most support that are refined.",
        chosen="By hand: the support of a sample ranks poses only roughly.",
    )
    first_steps: int = limit(
        3,
        "Gauss-Newton steps for each of these poses, after which the best one is chosen.",
        chosen="By hand: meant to be enough to compare them.",
    )
    final_steps: int = limit(
        5,
        "Further Gauss-Newton steps for the best pose.",
        chosen="By hand: meant to be enough to converge.",
    )
    ranking_matches: int = limit(
        250,
        "Matches, evenly spread over all, that are used to rank samples.",
        chosen="By hand, for speed: the rank of a sample needs fewer matches than its refinement.",
    )


OPTIONS = UprightOptions()


def estimate_upright_relative_pose(
    points_a_px: ArrayLike,
    points_b_px: ArrayLike,
    camera_a: Camera,
    camera_b: Camera,
    verticals: KnownVerticals,
    *,
    max_error_px: float = EPIPOLAR.relative_error_px,
    samples: int = OPTIONS.samples,
    seed: int = 0,
) -> RelativePoseEstimate | None:
    """Return the relative pose that fits matched pixels (n, 2), (n, 2) and the verticals best, or None.

    The matches on a single wall fit two relative poses, and nearly a family of them; in most of these one camera is
    tilted against the other, so the verticals exclude them. RANSAC with samples of three matches and exact verticals,
    then a robust least-squares fit in which the verticals have their standard deviation. None for fewer than eight
    matches or inliers. Raises `InvalidInputError` for
    numbers that are not finite. Source: Fraundorfer et al., "A minimal case solution to the calibrated relative pose
    problem for the case of two known orientation angles", 2010, the solver by `ESTIMATORS`; C eq. 4.2.1-4.2.4.
    """
    a, b = finite_pairs(points_a_px, 2, "pixels", points_b_px, 2, "pixels")
    if len(a) < MIN_FUNDAMENTAL_POINTS:
        return None
    rays_a, rays_b = homogeneous(camera_a.normalize(a)), homogeneous(camera_b.normalize(b))
    max_error = max_error_px / (0.5 * (camera_a.focal_px + camera_b.focal_px))
    rotations, translations = _sampled(rays_a, rays_b, verticals, samples, seed)
    if not len(rotations):
        return None
    some = slice(None, None, -(-len(a) // OPTIONS.ranking_matches))
    sample_error = OPTIONS.sample_error_ratio * max_error
    support = _support(rays_a[some], rays_b[some], rotations, translations, sample_error)
    problem = RelativePoseProblem(rays_a, rays_b, verticals, max_error)
    rows = np.argsort(-support, kind="stable")[: OPTIONS.refined_poses]
    first = [problem.refined(rotations[row], translations[row], OPTIONS.first_steps) for row in rows]
    _, rotation, translation = min(first, key=lambda found: found[0])
    _, rotation, translation = problem.refined(rotation, translation, OPTIONS.final_steps)
    pose = _facing(rays_a, rays_b, rotation, translation)
    return relative_estimate(a, b, camera_a, camera_b, pose, max_error_px)


def _sampled(
    rays_a: Array, rays_b: Array, verticals: KnownVerticals, samples: int, seed: int
) -> tuple[Array, Array]:
    """Return the rotations (k, 3, 3) and directions (k, 3) of all relative poses that fit a sample exactly."""
    level_a, level_b = rotation_between(verticals.in_a, DOWN), rotation_between(verticals.in_b, DOWN)
    units_a, units_b = unit_rays(rays_a) @ level_a.T, unit_rays(rays_b) @ level_b.T
    rows = np.random.default_rng(seed).integers(0, len(rays_a), (samples, 3))
    rows = rows[(np.diff(np.sort(rows, axis=1), axis=1) > 0).all(axis=1)]
    turns_rad, directions = ESTIMATORS.upright_relative_poses(units_a[rows], units_b[rows])
    lengths = np.linalg.norm(directions, axis=1)
    usable = np.isfinite(turns_rad) & np.isfinite(lengths) & (lengths > 1e-9)
    turns = _about_the_vertical(turns_rad[usable])
    return level_b.T @ turns @ level_a, directions[usable] / lengths[usable, None] @ level_b


def _about_the_vertical(angles_rad: Array) -> Array:
    """Return the rotations (k, 3, 3) about `DOWN` by angles (k,)."""
    cos, sin, none = np.cos(angles_rad), np.sin(angles_rad), np.zeros(len(angles_rad))
    rows = [[cos, none, sin], [none, none + 1.0, none], [-sin, none, cos]]
    return np.moveaxis(np.array(rows), 2, 0)


def _support(rays_a: Array, rays_b: Array, rotations: Array, translations: Array, max_error: float) -> Array:
    """Return the support (k,) of each pose: the sum over matches of 1 at no error, falling to 0 at `max_error`.

    The error is the sine of the angle between b's ray and the epipolar plane of a's ray; matrix products compute it
    for all poses and matches at once.
    """
    unit_a, unit_b = unit_rays(rays_a).astype(np.float32), unit_rays(rays_b).astype(np.float32)
    essential = np.cross(translations[:, :, None], rotations, axis=1).astype(np.float32)
    products = (unit_b[:, :, None] * unit_a[:, None, :]).reshape(-1, 9)
    error = essential.reshape(-1, 9) @ products.T
    along = np.einsum("ki,kij->kj", translations, rotations).astype(np.float32) @ unit_a.T
    error *= error
    error /= np.maximum(1.0 - along * along, 1e-9)
    return np.asarray(np.maximum(0.0, 1.0 - error / max_error**2).sum(axis=1), dtype=np.float64)


def _facing(rays_a: Array, rays_b: Array, rotation: Array, translation: Array) -> Pose:
    """Return the pose with the sign of the translation for which most matches are in front of both cameras."""
    poses = [Pose(rotation, sign * translation) for sign in (1.0, -1.0)]
    fronts = [np.count_nonzero(in_front_of_both(rays_a[:, :2], rays_b[:, :2], pose)) for pose in poses]
    return poses[int(np.argmax(fronts))]
