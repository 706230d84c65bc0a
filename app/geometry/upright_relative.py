"""The relative pose of two cameras whose verticals are known: three matches are a sample, and planes mislead less."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import poselib
from numpy.typing import ArrayLike, NDArray

from app.geometry.camera import Camera
from app.geometry.epipolar import (
    MIN_FUNDAMENTAL_POINTS,
    RelativePoseEstimate,
    in_front_of_both,
    relative_estimate,
    sampson_slopes,
)
from app.geometry.se3 import Pose, rotation_between, rotation_from_vector, skew
from app.geometry.triangulation import homogeneous
from app.geometry.validation import finite_pairs

Array = NDArray[np.float64]

DOWN = np.array([0.0, 1.0, 0.0])
# A sample's pose is off by the errors of three matches and of the verticals; so many of the best are refined.
SAMPLE_SLACK, REFINED, STEPS = 2.0, 4, 8
# One sigma of a match, as a share of the largest error; one further off than that error counts for nothing.
SIGMA_SHARE = 0.35


@dataclass(frozen=True, slots=True)
class KnownVerticals:
    """Down in the axes of two cameras, (3,) each, and one sigma, in radians, of the angle between them."""

    in_a: Array
    in_b: Array
    sigma_rad: float

    def information(self) -> Array:
        """Return what they say of a relative rotation, (3, 3), as an inverse covariance of its vector in b's axes:
        nothing of turns about the vertical."""
        return np.asarray((np.eye(3) - np.outer(self.in_b, self.in_b)) / self.sigma_rad**2)


def estimate_upright_relative_pose(
    points_a_px: ArrayLike,
    points_b_px: ArrayLike,
    camera_a: Camera,
    camera_b: Camera,
    verticals: KnownVerticals,
    *,
    max_error_px: float = 1.5,
    samples: int = 400,
    seed: int = 0,
) -> RelativePoseEstimate | None:
    """Return the relative pose that most matched pixels (n, 2), (n, 2) and the verticals agree on, or None.

    A wall leaves two poses, and nearly a family of them, that its matches can't tell apart; most of these tilt one
    camera against the other. RANSAC over three matches with exact verticals, then a robust least-squares fit in which
    the verticals have their sigma. None for fewer than eight matches or inliers. Raises `InvalidInputError` for
    numbers that are not finite. Source: Fraundorfer et al., "A minimal case solution to the calibrated relative pose
    problem for the case of two known orientation angles", 2010, the solver by PoseLib; C eq. 4.2.1-4.2.4.
    """
    a, b = finite_pairs(points_a_px, 2, "pixels", points_b_px, 2, "pixels")
    if len(a) < MIN_FUNDAMENTAL_POINTS:
        return None
    rays_a, rays_b = homogeneous(camera_a.normalize(a)), homogeneous(camera_b.normalize(b))
    max_error = max_error_px / (0.5 * (camera_a.focal_px + camera_b.focal_px))
    rotations, translations = _sampled(rays_a, rays_b, verticals, samples, seed)
    if not len(rotations):
        return None
    support = _support(rays_a, rays_b, rotations, translations, SAMPLE_SLACK * max_error)
    best: tuple[float, Pose] | None = None
    for row in np.argsort(-support, kind="stable")[:REFINED]:
        start = _facing(rays_a, rays_b, rotations[row], translations[row])
        cost, pose = _refined(rays_a, rays_b, start, verticals, max_error)
        if best is None or cost < best[0]:
            best = cost, pose
    return None if best is None else relative_estimate(a, b, camera_a, camera_b, best[1], max_error_px)


def _sampled(
    rays_a: Array, rays_b: Array, verticals: KnownVerticals, samples: int, seed: int
) -> tuple[Array, Array]:
    """Return the rotations (k, 3, 3) and directions (k, 3) of all poses that three matches each leave."""
    level_a, level_b = rotation_between(verticals.in_a, DOWN), rotation_between(verticals.in_b, DOWN)
    units_a = rays_a / np.linalg.norm(rays_a, axis=1, keepdims=True) @ level_a.T
    units_b = rays_b / np.linalg.norm(rays_b, axis=1, keepdims=True) @ level_b.T
    rows = np.random.default_rng(seed).integers(0, len(rays_a), (samples, 3))
    found = [
        pose
        for three in rows
        if len(set(three.tolist())) == 3
        for pose in poselib.relpose_upright_3pt(list(units_a[three]), list(units_b[three]))
    ]
    if not found:
        return np.zeros((0, 3, 3)), np.zeros((0, 3))
    turns = np.stack([pose.R for pose in found])
    directions = np.stack([pose.t for pose in found])
    lengths = np.linalg.norm(directions, axis=1)
    usable = np.isfinite(turns).all(axis=(1, 2)) & np.isfinite(lengths) & (lengths > 1e-9)
    return level_b.T @ turns[usable] @ level_a, directions[usable] / lengths[usable, None] @ level_b


def _support(
    rays_a: Array, rays_b: Array, rotations: Array, translations: Array, max_error: float
) -> Array:
    """Return how well the matches support each pose, (k,): one for a match in place, less to none at `max_error`.

    The error is the angle between b's ray and the epipolar plane of a's, from matrix products alone.
    """
    unit_a = (rays_a / np.linalg.norm(rays_a, axis=1, keepdims=True)).astype(np.float32)
    unit_b = (rays_b / np.linalg.norm(rays_b, axis=1, keepdims=True)).astype(np.float32)
    essential = np.cross(translations[:, :, None], rotations, axis=1).astype(np.float32)
    products = (unit_b[:, :, None] * unit_a[:, None, :]).reshape(-1, 9)
    error = essential.reshape(-1, 9) @ products.T
    along = np.einsum("ki,kij->kj", translations, rotations).astype(np.float32) @ unit_a.T
    error *= error
    error /= np.maximum(1.0 - along * along, 1e-9)
    return np.asarray(np.maximum(0.0, 1.0 - error / max_error**2).sum(axis=1), dtype=np.float64)


def _facing(rays_a: Array, rays_b: Array, rotation: Array, translation: Array) -> Pose:
    """Return the pose, of the two that differ in the translation's sign, that puts most matches before the cameras."""
    poses = [Pose(rotation, sign * translation) for sign in (1.0, -1.0)]
    fronts = [np.count_nonzero(in_front_of_both(rays_a[:, :2], rays_b[:, :2], pose)) for pose in poses]
    return poses[int(np.argmax(fronts))]


def _refined(
    rays_a: Array, rays_b: Array, start: Pose, verticals: KnownVerticals, max_error: float
) -> tuple[float, Pose]:
    """Return the least robust cost around a pose, and the pose there: Gauss-Newton with the verticals as a prior."""
    rotation, translation = start.rotation, start.translation
    best = (np.inf, start)
    sigma = SIGMA_SHARE * max_error
    for _ in range(STEPS):
        turned = rays_a @ rotation.T
        slopes = sampson_slopes(skew(translation) @ rotation, rays_a, rays_b) * sigma
        across = np.cross(turned, rays_b)
        errors = across @ translation / slopes
        tilt = np.cross(rotation @ verticals.in_a, verticals.in_b) / verticals.sigma_rad
        cost = float(np.log1p(np.minimum(errors**2, SIGMA_SHARE**-2)).sum() + tilt @ tilt)
        if cost < best[0]:
            best = cost, Pose(rotation, translation)
        weights = np.where(np.abs(errors) < 1.0 / SIGMA_SHARE, 1.0 / (1.0 + errors**2), 0.0)
        axes = np.linalg.svd(translation[None])[2][1:]
        by_turn = np.cross(turned, np.cross(rays_b, translation))
        jacobian = np.concatenate([by_turn, across @ axes.T], axis=1) / slopes[:, None]
        weighted = jacobian * weights[:, None]
        hessian, gradient = weighted.T @ jacobian, weighted.T @ errors
        seen = rotation @ verticals.in_a
        by_tilt = (np.outer(seen, verticals.in_b) - seen @ verticals.in_b * np.eye(3)) / verticals.sigma_rad
        hessian[:3, :3] += by_tilt.T @ by_tilt
        gradient[:3] += by_tilt.T @ tilt
        step = -np.linalg.solve(hessian + 1e-9 * np.trace(hessian) * np.eye(5), gradient)
        rotation = rotation_from_vector(step[:3]) @ rotation
        translation = translation + step[3:] @ axes
        translation = translation / np.linalg.norm(translation)
    return best
