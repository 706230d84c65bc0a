"""Two-view geometry: fundamental matrices, essential matrices and relative poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.errors import DegenerateGeometryError
from app.geometry.camera import Camera
from app.geometry.estimators.chosen import ESTIMATORS
from app.geometry.estimators.interface import MIN_FUNDAMENTAL_POINTS, RansacBudget
from app.geometry.sampson import sampson_errors
from app.geometry.se3 import Pose, skew
from app.geometry.triangulation import homogeneous, parallax_deg, pixel_depths
from app.geometry.validation import finite_pairs, finite_points
from app.limits import limit

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
FundamentalEstimator = Literal["magsac", "ransac"]

FUNDAMENTAL_METHODS = {"magsac": cv2.USAC_MAGSAC, "ransac": cv2.FM_RANSAC}


@dataclass(frozen=True, slots=True, kw_only=True)
class EpipolarOptions:
    """Inlier limits and budgets of the two-view estimators, unless a caller gives others."""

    fundamental_error_px: float = limit(
        3.0,
        "Largest distance of an inlier from its epipolar line, for a fundamental matrix.",
        chosen="By hand: the same as OpenCV's default.",
    )
    fundamental_iterations: int = limit(
        2000,
        "Largest number of RANSAC samples for a fundamental matrix.",
        chosen="By hand: bounds the time when most matches are wrong.",
    )
    relative_error_px: float = limit(
        1.5,
        "Largest epipolar error of an inlier of a relative pose.",
        chosen="By hand: descriptor matches have a pixel or two of noise.",
    )
    relative_iterations: int = limit(
        5000,
        "Largest number of RANSAC samples for a relative pose.",
        chosen="By hand: bounds the time when most matches are wrong.",
    )
    min_relative_iterations: int = limit(
        100,
        "Least number of RANSAC samples for a relative pose.",
        chosen="By hand: a few good samples are compared even when the first one fits well.",
    )
    confidence: float = limit(
        0.999,
        "RANSAC ends when a sample without outliers was drawn with this probability.",
        chosen="By hand: one failure in a thousand by chance.",
    )
    min_singular_ratio: float = limit(
        1e-9,
        "Least ratio of the eighth to the first singular value of the linear equations for an essential matrix.",
        chosen="By hand: below it, up to rounding, the matches fit more than one matrix.",
    )
    min_second_singular_ratio: float = limit(
        0.5,
        "Least ratio of the second to the first singular value of an essential matrix; exactly 1 in theory.",
        chosen="By hand: allows for noise.",
    )
    max_third_singular_ratio: float = limit(
        0.1,
        "Largest ratio of the third to the first singular value of an essential matrix; exactly 0 in theory.",
        chosen="By hand: allows for noise.",
    )
    min_front_share: float = limit(
        0.75,
        "Least share of the matches that must lie in front of both cameras by the pose that is chosen.",
        chosen="By hand: allows for points with little parallax.",
    )


OPTIONS = EpipolarOptions()


def filter_by_fundamental_matrix(
    points_a_px: ArrayLike,
    points_b_px: ArrayLike,
    *,
    max_error_px: float = OPTIONS.fundamental_error_px,
    confidence: float = OPTIONS.confidence,
    max_iterations: int = OPTIONS.fundamental_iterations,
    seed: int = 0,
    estimator: FundamentalEstimator = "magsac",
) -> Mask:
    """Return which matched pixels (n, 2), (n, 2) of two images lie on each other's epipolar lines.

    The mask (n,) is all False for fewer than eight matches or when no matrix is found. Raises `InvalidInputError`
    for numbers that are not finite. Source: A section 2.3.
    """
    a, b = finite_pairs(points_a_px, 2, "pixels", points_b_px, 2, "pixels")
    none = np.zeros(len(a), dtype=bool)
    if len(a) < MIN_FUNDAMENTAL_POINTS:
        return none
    cv2.setRNGSeed(seed)
    try:
        _, mask = cv2.findFundamentalMat(
            a, b, FUNDAMENTAL_METHODS[estimator], max_error_px, confidence, max_iterations
        )
    except cv2.error:  # Raised for points in one spot, where no sample gives a matrix.
        return none
    return none if mask is None else np.asarray(mask[:, 0] != 0)


@dataclass(frozen=True, slots=True)
class RelativePoseEstimate:
    """The relative pose of two cameras, up to scale, and the matches that agree with it.

    `b_from_a` has a translation of length 1. `inlier_mask` (n,) marks the matches within the error limit whose
    points are in front of both cameras. `parallax_deg` is the median angle between their rays: near zero both
    cameras have one centre, and the translation is meaningless.
    """

    b_from_a: Pose
    inlier_mask: Mask
    parallax_deg: float


def estimate_relative_pose(
    points_a_px: ArrayLike,
    points_b_px: ArrayLike,
    camera_a: Camera,
    camera_b: Camera,
    *,
    max_error_px: float = OPTIONS.relative_error_px,
    max_iterations: int = OPTIONS.relative_iterations,
    seed: int = 0,
) -> RelativePoseEstimate | None:
    """Return the relative pose with the most inliers among matched pixels (n, 2), (n, 2), or None if there is none.

    Locally optimized RANSAC with five-point samples and a robust refinement, with each camera's own model.
    None for fewer than eight matches or eight inliers. Raises `InvalidInputError` for numbers that are not
    finite. Source: C eq. 4.2.1-4.2.4, by `ESTIMATORS`.
    """
    a, b = finite_pairs(points_a_px, 2, "pixels", points_b_px, 2, "pixels")
    if len(a) < MIN_FUNDAMENTAL_POINTS:
        return None
    budget = RansacBudget(
        max_error_px=max_error_px,
        max_iterations=max_iterations,
        min_iterations=OPTIONS.min_relative_iterations,
        seed=seed,
    )
    b_from_a = ESTIMATORS.relative_pose(a, b, (camera_a, camera_b), budget)
    if b_from_a is None:
        return None
    return relative_estimate(a, b, camera_a, camera_b, b_from_a, max_error_px)


def estimate_relative_pose_svd(
    points_a_px: ArrayLike,
    points_b_px: ArrayLike,
    camera_a: Camera,
    camera_b: Camera,
    *,
    max_error_px: float = OPTIONS.relative_error_px,
    confidence: float = OPTIONS.confidence,
    seed: int = 0,
) -> RelativePoseEstimate | None:
    """Return the relative pose of matched pixels (n, 2), (n, 2) by the thesis's method, or None.

    Essential matrix by RANSAC on normalized coordinates, so that the two K may differ, then SVD and cheirality.
    Returns None and raises errors as `estimate_relative_pose`. Source: C eq. 4.2.1-4.2.4 and section 4.2.2.
    """
    a, b = finite_pairs(points_a_px, 2, "pixels", points_b_px, 2, "pixels")
    if len(a) < MIN_FUNDAMENTAL_POINTS:
        return None
    rays_a, rays_b = camera_a.normalize(a), camera_b.normalize(b)
    cv2.setRNGSeed(seed)
    E, mask = cv2.findEssentialMat(
        rays_a, rays_b, np.eye(3), cv2.RANSAC, confidence, max_error_px / _mean_focal_px(camera_a, camera_b)
    )
    if E is None or E.shape != (3, 3) or np.count_nonzero(mask) < MIN_FUNDAMENTAL_POINTS:
        return None
    chosen = mask[:, 0] != 0
    try:
        b_from_a = relative_pose_from_essential(E, rays_a[chosen], rays_b[chosen])
    except DegenerateGeometryError:
        return None
    return relative_estimate(a, b, camera_a, camera_b, b_from_a, max_error_px)


def essential_from_points(normalized_a: ArrayLike, normalized_b: ArrayLike) -> Array:
    """Return the essential matrix (3, 3) of matches in image-plane coordinates (n, 2), (n, 2).

    Linear least squares of b^T E a = 0 over at least eight matches, all of them inliers, then the nearest matrix
    with two equal singular values. The coordinates are K^-1 x of the match's own camera. Raises
    `DegenerateGeometryError` for fewer than eight points, or points that don't determine the matrix. Source: C eq.
    4.2.4; Hartley's eight-point algorithm.
    """
    a, b = finite_pairs(normalized_a, 2, "image-plane points", normalized_b, 2, "image-plane points")
    if len(a) < MIN_FUNDAMENTAL_POINTS:
        raise DegenerateGeometryError("An essential matrix by linear equations needs eight matches.")
    to_unit_a, to_unit_b = _conditioner(a), _conditioner(b)
    rays_a, rays_b = homogeneous(a) @ to_unit_a.T, homogeneous(b) @ to_unit_b.T
    _, singular, vt = np.linalg.svd((rays_b[:, :, None] * rays_a[:, None, :]).reshape(-1, 9))
    if singular[7] < OPTIONS.min_singular_ratio * singular[0]:
        raise DegenerateGeometryError(
            "The matches fit many essential matrices: are they on one plane or line?"
        )
    E = to_unit_b.T @ vt[-1].reshape(3, 3) @ to_unit_a
    u, _, vt = np.linalg.svd(E)
    return np.asarray(u @ np.diag([1.0, 1.0, 0.0]) @ vt)


def essential_from_pose(b_from_a: Pose) -> Array:
    """Return the essential matrix (3, 3), skew(t) R, of a relative pose (C eq. 4.2.4)."""
    return np.asarray(skew(b_from_a.translation) @ b_from_a.rotation)


def decompose_essential(E: ArrayLike) -> list[Pose]:
    """Return the four `b_from_a`, with translations of length 1, that have a given essential matrix (3, 3).

    Raises `DegenerateGeometryError` for a matrix whose singular values are far from two equal ones and a zero.
    Source: C section 4.2.2; Hartley and Zisserman, result 9.19.
    """
    u, values, vt = np.linalg.svd(finite_points(E, 3, "essential matrix rows"))
    second, third = OPTIONS.min_second_singular_ratio, OPTIONS.max_third_singular_ratio
    if values[1] < second * values[0] or values[2] > third * values[0]:
        raise DegenerateGeometryError("The matrix is not an essential matrix.")
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    # The sign of an essential matrix is arbitrary, and so is the sign of its factors' determinant.
    rotations = [r * np.sign(np.linalg.det(r)) for r in (u @ quarter @ vt, u @ quarter.T @ vt)]
    return [Pose(r, t) for r in rotations for t in (u[:, 2], -u[:, 2])]


def relative_pose_from_essential(E: ArrayLike, normalized_a: ArrayLike, normalized_b: ArrayLike) -> Pose:
    """Return the `b_from_a`, of the four, for which most matches (n, 2), (n, 2) are in front of both cameras.

    Raises `DegenerateGeometryError` when fewer than `OPTIONS.min_front_share` of them are, or when two poses have
    equally many: then the matches don't determine the pose (no parallax, or not an essential matrix). Source: C
    section 4.2.2, cheirality.
    """
    poses = decompose_essential(E)
    counts = [int(np.count_nonzero(in_front_of_both(normalized_a, normalized_b, pose))) for pose in poses]
    order = np.argsort(counts)
    best, second = counts[order[-1]], counts[order[-2]]
    if best < OPTIONS.min_front_share * len(np.asarray(normalized_a)) or best == second:
        raise DegenerateGeometryError("The matches don't tell on which side of the cameras they lie.")
    return poses[int(order[-1])]


def in_front_of_both(normalized_a: ArrayLike, normalized_b: ArrayLike, b_from_a: Pose) -> Mask:
    """Return whether the points (n,) of image-plane matches (n, 2), (n, 2) are in front of both cameras."""
    s1, s2 = pixel_depths(normalized_a, normalized_b, b_from_a)
    with np.errstate(invalid="ignore"):
        return np.asarray((s1 > 0) & (s2 > 0))


def relative_estimate(
    a: Array, b: Array, camera_a: Camera, camera_b: Camera, b_from_a: Pose, max_error_px: float
) -> RelativePoseEstimate | None:
    """Return a pose with its inliers among matched pixels (n, 2), (n, 2), or None when it has fewer than eight."""
    rays_a, rays_b = camera_a.normalize(a), camera_b.normalize(b)
    errors = sampson_errors(essential_from_pose(b_from_a), rays_a, rays_b)
    near = errors * _mean_focal_px(camera_a, camera_b) <= max_error_px
    inliers = near & in_front_of_both(rays_a, rays_b, b_from_a)
    if np.count_nonzero(inliers) < MIN_FUNDAMENTAL_POINTS:
        return None
    return RelativePoseEstimate(
        b_from_a, inliers, float(np.median(parallax_deg(rays_a[inliers], rays_b[inliers], b_from_a)))
    )


def _mean_focal_px(camera_a: Camera, camera_b: Camera) -> float:
    return 0.5 * (camera_a.focal_px + camera_b.focal_px)


def _conditioner(points: Array) -> Array:
    """Return the matrix (3, 3) that brings points (n, 2) to mean 0 and mean distance sqrt(2) (Hartley)."""
    mean = points.mean(axis=0)
    spread = float(np.mean(np.linalg.norm(points - mean, axis=1)))
    if spread < 1e-9:
        raise DegenerateGeometryError("All points coincide.")
    scale = np.sqrt(2.0) / spread
    return np.array([[scale, 0, -scale * mean[0]], [0, scale, -scale * mean[1]], [0, 0, 1.0]])
