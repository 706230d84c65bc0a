"""Rigid transforms: `Pose`, and functions of rotations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.errors import InvalidPoseError
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseOptions:
    """What is accepted as a rotation matrix."""

    max_rotation_deviation: float = limit(
        0.05,
        "Largest difference of an element of a given rotation matrix from the nearest rotation.",
        chosen="By hand: far above the error of numbers that were typed with three decimals, about 0.001.",
    )


OPTIONS = PoseOptions()


def project_to_so3(matrix: ArrayLike) -> Array:
    """Return the rotation (3, 3) nearest to `matrix` in the Frobenius norm (Procrustes, by SVD)."""
    u, _, vt = np.linalg.svd(np.asarray(matrix, dtype=np.float64))
    correction = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    return np.asarray(u @ correction @ vt)


def rotation_from_quaternion(x: float, y: float, z: float, w: float) -> Array:
    """Return the rotation (3, 3) of a quaternion of any non-zero length, scalar last (A eq. 8)."""
    q = np.array([x, y, z, w], dtype=np.float64)
    norm = float(np.linalg.norm(q))
    if not np.isfinite(norm) or norm < 1e-6:
        raise InvalidPoseError("A quaternion needs four finite numbers that are not all zero.")
    x, y, z, w = q / norm
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_from_rotation(R: Array) -> Array:
    """Return the unit quaternion (4,) `x y z w` of a rotation (3, 3), with w >= 0 (inverse of A eq. 8)."""
    # The eigenvector of the largest eigenvalue of Bar-Itzhack's matrix is accurate for all rotations.
    k = (
        np.array(
            [
                [R[0, 0] - R[1, 1] - R[2, 2], 0, 0, 0],
                [R[0, 1] + R[1, 0], R[1, 1] - R[0, 0] - R[2, 2], 0, 0],
                [R[0, 2] + R[2, 0], R[1, 2] + R[2, 1], R[2, 2] - R[0, 0] - R[1, 1], 0],
                [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], R[0, 0] + R[1, 1] + R[2, 2]],
            ]
        )
        / 3.0
    )
    q = np.linalg.eigh(k)[1][:, -1]
    return np.asarray(-q if q[3] < 0 else q)


def rotation_from_vector(vector: ArrayLike) -> Array:
    """Return the rotation (3, 3) by |vector| radians about `vector` (3,) (Rodrigues' formula)."""
    v = np.asarray(vector, dtype=np.float64)
    angle_rad = float(np.linalg.norm(v))
    if angle_rad < 1e-12:
        return np.eye(3) + skew(v)
    k = skew(v / angle_rad)
    return np.asarray(np.eye(3) + np.sin(angle_rad) * k + (1 - np.cos(angle_rad)) * (k @ k))


def vector_from_rotation(R: Array) -> Array:
    """Return the rotation vector (3,), at most pi long, of a rotation (3, 3): inverse of `rotation_from_vector`."""
    q = quaternion_from_rotation(R)
    sin_half = float(np.linalg.norm(q[:3]))
    if sin_half < 1e-12:
        return np.asarray(2.0 * q[:3])
    return np.asarray(q[:3] / sin_half * 2.0 * np.arctan2(sin_half, q[3]))


def rotation_between(a: ArrayLike, b: ArrayLike) -> Array:
    """Return the smallest rotation (3, 3) that maps direction `a` (3,) to direction `b` (3,)."""
    u = np.asarray(a, dtype=np.float64) / np.linalg.norm(a)
    v = np.asarray(b, dtype=np.float64) / np.linalg.norm(b)
    axis = np.cross(u, v)
    sin, cos = float(np.linalg.norm(axis)), float(u @ v)
    if sin < 1e-9:
        if cos > 0:
            return np.eye(3)
        axis = np.cross(u, np.eye(3)[np.argmin(np.abs(u))])
        return rotation_from_vector(np.pi * axis / np.linalg.norm(axis))
    return rotation_from_vector(axis / sin * np.arctan2(sin, cos))


def skew(v: ArrayLike) -> Array:
    """Return the matrix (3, 3) for which `skew(v) @ a` is the cross product of `v` and `a`."""
    x, y, z = np.asarray(v, dtype=np.float64)
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def rotation_angle_deg(R: Array) -> float:
    """Return the angle of a rotation (3, 3) in degrees, 0 to 180."""
    sin = 0.5 * float(np.linalg.norm([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]))
    return float(np.degrees(np.arctan2(sin, 0.5 * (np.trace(R) - 1.0))))


@dataclass(frozen=True, slots=True)
class Pose:
    """A rigid transform `target_from_source`: x_target = rotation @ x_source + translation (metres).

    The constructor projects the rotation to SO(3), because files contain rounded numbers, and raises
    `InvalidPoseError` for numbers that are not finite or a matrix that is far from any rotation. Name each
    variable after its frames: `world_from_camera @ camera_from_body` is `world_from_body`.
    """

    rotation: Array
    translation: Array

    def __post_init__(self) -> None:
        rotation = np.asarray(self.rotation, dtype=np.float64)
        translation = np.asarray(self.translation, dtype=np.float64).reshape(-1)
        if rotation.shape != (3, 3) or translation.shape != (3,):
            raise InvalidPoseError("A pose needs a 3x3 rotation and a translation of three numbers.")
        if not (np.isfinite(rotation).all() and np.isfinite(translation).all()):
            raise InvalidPoseError("A pose holds numbers that are not finite.")
        projected = project_to_so3(rotation)
        if np.abs(projected - rotation).max() > OPTIONS.max_rotation_deviation:
            raise InvalidPoseError("The rotation part of the pose is not a rotation matrix.")
        projected.setflags(write=False)
        translation = translation.copy()
        translation.setflags(write=False)
        object.__setattr__(self, "rotation", projected)
        object.__setattr__(self, "translation", translation)

    @staticmethod
    def identity() -> Pose:
        """Return the identity."""
        return Pose(np.eye(3), np.zeros(3))

    @staticmethod
    def from_matrix(matrix: ArrayLike) -> Pose:
        """Return the pose of a matrix (4, 4) (A eq. 7); raises `InvalidPoseError` for another shape."""
        m = np.asarray(matrix, dtype=np.float64)
        if m.shape != (4, 4) or not np.allclose(m[3], [0, 0, 0, 1], atol=1e-6):
            raise InvalidPoseError("A rigid transform is a 4x4 matrix whose last row is 0 0 0 1.")
        return Pose(m[:3, :3], m[:3, 3])

    @staticmethod
    def from_quaternion(position: ArrayLike, quaternion_xyzw: ArrayLike) -> Pose:
        """Return the pose of a position (3,) in metres and a quaternion (4,) `x y z w` (A eq. 7-8)."""
        q = np.asarray(quaternion_xyzw, dtype=np.float64)
        if q.shape != (4,):
            raise InvalidPoseError("A quaternion needs four numbers.")
        return Pose(rotation_from_quaternion(*q), np.asarray(position, dtype=np.float64))

    @property
    def matrix(self) -> Array:
        """The homogeneous matrix (4, 4) (A eq. 7)."""
        m = np.eye(4)
        m[:3, :3], m[:3, 3] = self.rotation, self.translation
        return m

    @property
    def quaternion(self) -> Array:
        """The unit quaternion (4,) `x y z w`, w >= 0."""
        return quaternion_from_rotation(self.rotation)

    def inverse(self) -> Pose:
        """Return `source_from_target`."""
        return Pose(self.rotation.T, -self.rotation.T @ self.translation)

    def __matmul__(self, other: Pose) -> Pose:
        """Return the composition: `a_from_b @ b_from_c` is `a_from_c`."""
        return Pose(self.rotation @ other.rotation, self.rotation @ other.translation + self.translation)

    def apply(self, points_in_source: ArrayLike) -> Array:
        """Return the points (..., 3) in the target frame of points (..., 3) in the source frame (A eq. 9)."""
        return np.asarray(np.asarray(points_in_source, dtype=np.float64) @ self.rotation.T + self.translation)


def perturbed(world_from_camera: Pose, step: ArrayLike) -> Pose:
    """Return the pose rotated about its centre by step[:3] (rad, world axes) and moved by step[3:] (m)."""
    delta = np.asarray(step, dtype=np.float64)
    rotation = rotation_from_vector(delta[:3]) @ world_from_camera.rotation
    return Pose(rotation, world_from_camera.translation + delta[3:])


def position_difference_m(a: Pose, b: Pose) -> float:
    """Return the distance in metres between the origins of two `world_from_camera` poses."""
    return float(np.linalg.norm(a.translation - b.translation))


def attitude_difference_rad(a: Pose, b: Pose) -> float:
    """Return the angle in radians of the rotation between two `world_from_camera` poses."""
    return float(np.radians(rotation_angle_deg(a.rotation.T @ b.rotation)))
