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
from app.geometry.triangulation import homogeneous, unit_rays
from app.geometry.validation import finite_pairs

Array = NDArray[np.float64]

DOWN = np.array([0.0, 1.0, 0.0])
# A sample's pose is off by the errors of three matches and of the verticals. So many of the best are refined in a few
# steps, and the best of these to the end.
SAMPLE_SLACK, REFINED, FIRST_STEPS, STEPS = 2.0, 3, 3, 5
# So many matches, evenly spread over all, rank the samples.
RANKING_MATCHES = 250
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
    samples: int = 300,
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
    some = slice(None, None, -(-len(a) // RANKING_MATCHES))
    support = _support(rays_a[some], rays_b[some], rotations, translations, SAMPLE_SLACK * max_error)
    problem = _Problem(rays_a, rays_b, verticals, max_error)
    rows = np.argsort(-support, kind="stable")[:REFINED]
    first = [problem.refined(rotations[row], translations[row], FIRST_STEPS) for row in rows]
    _, rotation, translation = min(first, key=lambda found: found[0])
    _, rotation, translation = problem.refined(rotation, translation, STEPS)
    pose = _facing(rays_a, rays_b, rotation, translation)
    return relative_estimate(a, b, camera_a, camera_b, pose, max_error_px)


def _sampled(
    rays_a: Array, rays_b: Array, verticals: KnownVerticals, samples: int, seed: int
) -> tuple[Array, Array]:
    """Return the rotations (k, 3, 3) and directions (k, 3) of all poses that three matches each leave."""
    level_a, level_b = rotation_between(verticals.in_a, DOWN), rotation_between(verticals.in_b, DOWN)
    units_a, units_b = unit_rays(rays_a) @ level_a.T, unit_rays(rays_b) @ level_b.T
    rows = np.random.default_rng(seed).integers(0, len(rays_a), (samples, 3))
    rows = rows[(np.diff(np.sort(rows, axis=1), axis=1) > 0).all(axis=1)]
    found = [
        pose
        for three_a, three_b in zip(units_a[rows], units_b[rows], strict=True)
        for pose in poselib.relpose_upright_3pt(list(three_a), list(three_b))
    ]
    if not found:
        return np.zeros((0, 3, 3)), np.zeros((0, 3))
    halves = np.array([pose.q for pose in found])
    directions = np.array([pose.t for pose in found])
    lengths = np.linalg.norm(directions, axis=1)
    usable = np.isfinite(halves).all(axis=1) & np.isfinite(lengths) & (lengths > 1e-9)
    turns = _about_the_vertical(2.0 * np.arctan2(halves[usable, 2], halves[usable, 0]))
    return level_b.T @ turns @ level_a, directions[usable] / lengths[usable, None] @ level_b


def _about_the_vertical(angles_rad: Array) -> Array:
    """Return the rotations (k, 3, 3) about `DOWN` by some angles (k,)."""
    cos, sin, none = np.cos(angles_rad), np.sin(angles_rad), np.zeros(len(angles_rad))
    rows = [[cos, none, sin], [none, none + 1.0, none], [-sin, none, cos]]
    return np.moveaxis(np.array(rows), 2, 0)


def _support(rays_a: Array, rays_b: Array, rotations: Array, translations: Array, max_error: float) -> Array:
    """Return how well the matches support each pose, (k,): one for a match in place, less to none at `max_error`.

    The error is the angle between b's ray and the epipolar plane of a's, from matrix products alone.
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
    """Return the pose, of the two that differ in the translation's sign, that puts most matches before the cameras."""
    poses = [Pose(rotation, sign * translation) for sign in (1.0, -1.0)]
    fronts = [np.count_nonzero(in_front_of_both(rays_a[:, :2], rays_b[:, :2], pose)) for pose in poses]
    return poses[int(np.argmax(fronts))]


@dataclass(frozen=True, slots=True)
class _Problem:
    """Matched rays (n, 3), (n, 3), the verticals, and the error from which a match counts for nothing."""

    rays_a: Array
    rays_b: Array
    verticals: KnownVerticals
    max_error: float

    def refined(self, rotation: Array, translation: Array, steps: int) -> tuple[float, Array, Array]:
        """Return the least robust cost around a pose, and the pose there: Gauss-Newton, the verticals as a prior."""
        best = np.inf, rotation, translation
        for _ in range(steps):
            cost, hessian, gradient, axes = self._system(rotation, translation)
            if cost < best[0]:
                best = cost, rotation, translation
            step = -np.linalg.solve(hessian + 1e-9 * np.trace(hessian) * np.eye(5), gradient)
            rotation = rotation_from_vector(step[:3]) @ rotation
            translation = translation + step[3:] @ axes
            translation = translation / np.linalg.norm(translation)
        cost, *_ = self._system(rotation, translation)
        return (cost, rotation, translation) if cost < best[0] else best

    def _system(self, rotation: Array, translation: Array) -> tuple[float, Array, Array, Array]:
        """Return the cost, the normal equations (5, 5), (5,) for a rotation vector and two turns of the translation,
        and the axes (2, 3) along which it is turned."""
        axes = np.linalg.svd(translation[None])[2][1:]
        turned = self.rays_a @ rotation.T
        slopes = sampson_slopes(skew(translation) @ rotation, self.rays_a, self.rays_b)
        slopes *= SIGMA_SHARE * self.max_error
        across = _cross(turned, self.rays_b)
        errors = across @ translation / slopes
        by_turn = _cross(turned, self.rays_b @ skew(translation).T) * -1.0
        jacobian = np.concatenate([by_turn, across @ axes.T], axis=1) / slopes[:, None]
        weights = np.where(np.abs(errors) < 1.0 / SIGMA_SHARE, 1.0 / (1.0 + errors**2), 0.0)
        weighted = jacobian * weights[:, None]
        hessian, gradient = weighted.T @ jacobian, weighted.T @ errors
        down, sigma = rotation @ self.verticals.in_a, self.verticals.sigma_rad
        tilt = np.cross(down, self.verticals.in_b) / sigma
        by_tilt = (np.outer(down, self.verticals.in_b) - down @ self.verticals.in_b * np.eye(3)) / sigma
        hessian[:3, :3] += by_tilt.T @ by_tilt
        gradient[:3] += by_tilt.T @ tilt
        cost = float(np.log1p(np.minimum(errors**2, SIGMA_SHARE**-2)).sum() + tilt @ tilt)
        return cost, hessian, gradient, axes


def _cross(a: Array, b: Array) -> Array:
    """Return the cross products (n, 3) of rows, several times as fast as NumPy's general one."""
    x, y, z = a.T
    u, v, w = b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)
