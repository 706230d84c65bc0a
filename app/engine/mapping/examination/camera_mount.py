"""A camera mounted at an angle: one fixed rotation between it and the body whose poses the scan holds."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from app.engine.mapping.examination.agreement import Rays, misfit
from app.engine.mapping.examination.evidence import Evidence
from app.geometry.camera import Camera
from app.geometry.se3 import rotation_angle_deg, rotation_from_vector, vector_from_rotation
from app.importers.conventions import PoseArrays
from app.limits import limit

Array = NDArray[np.float64]
_MEASURED = (
    "By hand, on parts of RedKitchen, freiburg1_rpy, desk_rs and the demonstration scan: right ones have a fitted "
    "angle times the logarithm of the gain of up to 0.44, cameras 3 degrees off or more of 0.7 to 25; "
    "`roomfix examine-mistakes` makes this mistake."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraMountOptions:
    """When a fixed rotation between camera and poses is believed."""

    searched_matches: int = limit(
        40,
        "Matches of a pair that the search looks at.",
        chosen="By hand: the search then takes a tenth of a second.",
    )
    first_step_rad: float = limit(
        0.08, "Rotation that the search tries first about each axis.", chosen="By hand: of 3 to 8 degrees."
    )
    iterations: int = limit(
        200, "Most values of the cost that a search computes.", chosen="By hand: it ends after about 100."
    )
    least_deg: float = limit(1.8, "The least angle that counts.", chosen=_MEASURED)
    most_deg: float = limit(
        20.0,
        "The largest angle that counts: other axes are told apart by themselves.",
        chosen="By hand: brackets are made straight, and are off by a few degrees.",
    )
    gain: float = limit(1.2, "By how much the misfit must be less with the rotation.", chosen=_MEASURED)
    least_product_deg: float = limit(
        0.6, "The least product of the angle and the logarithm of that gain.", chosen=_MEASURED
    )
    apart_deg: float = limit(
        1.0,
        "Angle between the rotations by one half of the pairs and by the other, up to which the rotation is beyond "
        "doubt.",
        chosen="By hand: a map whose pictures are a degree off is as good as a trajectory usually is.",
    )


OPTIONS = CameraMountOptions()


@dataclass(frozen=True, slots=True)
class CameraMount:
    """The rotation vector `body_from_camera` in degrees, and whether both halves of the pairs show the same."""

    vector_deg: tuple[float, float, float]
    is_certain: bool

    def applied(self, poses: PoseArrays) -> PoseArrays:
        """Return the poses (n, ...) of the camera, for those of the body."""
        return PoseArrays(
            poses.rotations @ rotation_from_vector(np.radians(self.vector_deg)), poses.positions
        )


def fit_camera_mount(evidence: Evidence, camera: Camera, poses: PoseArrays) -> CameraMount | None:
    """Return the rotation of the camera against its poses that the matches show; None where they show none.

    By the hand-eye relation a wrong fixed rotation X turns the motion R of a pair into X^T R X: an error that points
    the same way in all pairs, so that a few degrees show even where each single pair is within its tolerance.
    """
    few = evidence.thinned(OPTIONS.searched_matches)
    rays = Rays.of(few, camera)
    fitted = _fitted(few, rays, poses)
    gain = misfit(few, rays, poses) / max(misfit(few, rays, _turned(poses, fitted)), 1e-9)
    angle_deg = float(np.degrees(np.linalg.norm(fitted)))
    if not OPTIONS.least_deg <= angle_deg <= OPTIONS.most_deg or gain < OPTIONS.gain:
        return None
    if angle_deg * np.log(gain) < OPTIONS.least_product_deg:
        return None
    x, y, z = (round(float(value), 2) for value in np.degrees(fitted))
    return CameraMount((x, y, z), _halves_agree(few, camera, poses))


def _fitted(evidence: Evidence, rays: Rays, poses: PoseArrays) -> Array:
    def cost(vector: np.ndarray[tuple[int], np.dtype[np.float64]]) -> float:
        return misfit(evidence, rays, _turned(poses, vector))

    found = minimize(
        cost,
        np.zeros(3),
        method="Nelder-Mead",
        options={
            "initial_simplex": np.vstack([np.zeros(3), OPTIONS.first_step_rad * np.eye(3)]),
            "maxfev": OPTIONS.iterations,
            "xatol": 1e-4,
            "fatol": 1e-5,
        },
    )
    return np.asarray(found.x)


def _turned(poses: PoseArrays, vector: Array) -> PoseArrays:
    return replace(poses, rotations=poses.rotations @ rotation_from_vector(vector))


def _halves_agree(evidence: Evidence, camera: Camera, poses: PoseArrays) -> bool:
    fits = []
    for start in (0, 1):
        half = evidence.of_pairs(np.arange(evidence.pairs) % 2 == start)
        fits.append(rotation_from_vector(_fitted(half, Rays.of(half, camera), poses)))
    return rotation_angle_deg(fits[0].T @ fits[1]) <= OPTIONS.apart_deg


def joined_deg(
    first: tuple[float, float, float], then: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Return the rotation vector in degrees of two rotations, one after the other."""
    turned = rotation_from_vector(np.radians(first)) @ rotation_from_vector(np.radians(then))
    x, y, z = (round(float(value), 2) for value in np.degrees(vector_from_rotation(turned)))
    return x, y, z
