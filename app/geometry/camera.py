"""Camera intrinsics with COLMAP's model names, projection and undistortion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.errors import InvalidCameraError
from app.limits import limit

Array = NDArray[np.float64]

# Number of parameters of each model: fx fy cx cy, then the distortion coefficients in COLMAP's order.
# OPENCV: k1 k2 p1 p2. FULL_OPENCV: k1 k2 p1 p2 k3 k4 k5 k6. OPENCV_FISHEYE: k1 k2 k3 k4 (equidistant).
MODEL_PARAMETERS = {"PINHOLE": 4, "OPENCV": 8, "FULL_OPENCV": 12, "OPENCV_FISHEYE": 8}

# Limits in pixels are stated for this focal length, that of the first Kinect's colour camera.
REFERENCE_FOCAL_PX = 525.0
# A point with a smaller z, in the unit of the points, is not in front of a camera.
MIN_DEPTH = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraOptions:
    """Which intrinsics are plausible, and how a lens model is inverted."""

    min_focal_ratio: float = limit(
        0.134,
        "Least focal length over the longer side of the image.",
        chosen="By hand: 150 degrees of view; no lens that takes photographs has more.",
    )
    max_focal_ratio: float = limit(
        11.45,
        "Largest focal length over the longer side of the image.",
        chosen="By hand: 5 degrees of view; no lens that takes photographs has less.",
    )
    max_pixel_aspect_ratio: float = limit(
        2.0,
        "Largest ratio of fx to fy, and of fy to fx.",
        chosen="By hand: the pixels of real cameras are nearly square.",
    )
    max_principal_point_offset_ratio: float = limit(
        0.35,
        "Largest distance of the principal point from the image centre, relative to the image's size.",
        chosen="By hand: cropping moves the principal point, but not out of the middle part of the image.",
    )
    max_distortion: float = limit(
        50.0,
        "Largest absolute value of a distortion coefficient.",
        chosen="By hand: above that of any real lens, and above what can be undistorted in a stable way.",
    )
    max_side_px: int = limit(
        100_000,
        "Largest width and height of a camera's image.",
        chosen="By hand: ten times that of the largest sensor; what is larger is a damaged file.",
    )
    max_aspect_difference_ratio: float = limit(
        0.02,
        "Largest relative difference of aspect ratios at which one image is a resampled copy of the other.",
        chosen="By hand: the rounding of sizes stays below it.",
    )
    undistortion_iterations: int = limit(
        50,
        "Largest number of iterations when a point is undistorted.",
        chosen="By hand: strong distortion converges slowly.",
    )
    undistortion_tolerance: float = limit(
        1e-10,
        "Undistortion ends when the image-plane error is below this.",
        chosen="By hand: far below a pixel.",
    )
    max_fold_tangent: float = limit(
        10.0,
        "A lens model is searched for a fold up to this tangent of the angle from the optical axis.",
        chosen="By hand: 84 degrees.",
    )
    fold_samples: int = limit(
        5000,
        "Samples of the radius in the search for a fold.",
        chosen="By hand: a step of 0.002 in the tangent.",
    )
    fisheye_fold_samples: int = limit(
        2000,
        "Samples of the angle in the search for the fold of a fisheye model.",
        chosen="By hand: a step of 0.05 degrees.",
    )


OPTIONS = CameraOptions()


def tangent_of_px(pixels: float) -> float:
    """Return the angle, as its tangent, that a length in pixels is at the reference focal length.

    A limit in this form is the same for all cameras; multiplied by a camera's focal length it is in pixels again.
    """
    return pixels / REFERENCE_FOCAL_PX


@dataclass(frozen=True, slots=True)
class Camera:
    """Intrinsics: COLMAP model name, size in pixels, parameters (fx fy cx cy in pixels first).

    The centre of the first pixel is at (0, 0). Raises `InvalidCameraError` for an unknown model, a wrong
    number of parameters, numbers that are not finite, or intrinsics that no camera of this size has.
    """

    model: str
    width: int
    height: int
    params: tuple[float, ...]

    def __post_init__(self) -> None:
        expected = MODEL_PARAMETERS.get(self.model)
        if expected is None:
            raise InvalidCameraError(
                f"Camera model {self.model!r} is not known; use one of {', '.join(MODEL_PARAMETERS)}."
            )
        if len(self.params) != expected:
            others = [model for model, count in MODEL_PARAMETERS.items() if count == len(self.params)]
            meant = f"; as many has {' or '.join(others)}" if others else ""
            raise InvalidCameraError(
                f"{self.model} takes {expected} parameters, got {len(self.params)}{meant}."
            )
        if not np.isfinite(self.params).all():
            raise InvalidCameraError("Camera parameters must be finite numbers.")
        if self.width < 1 or self.height < 1:
            raise InvalidCameraError("A camera's width and height are at least one pixel.")
        if max(self.width, self.height) > OPTIONS.max_side_px:
            raise InvalidCameraError(
                f"A camera's width and height are at most {OPTIONS.max_side_px:,} pixels."
            )
        self._check_plausible()

    def _check_plausible(self) -> None:
        fx, fy, cx, cy = self.params[:4]
        shares = as_shares(self.params, self.width, self.height)
        if shares is not None:
            raise InvalidCameraError(shares)
        size = max(self.width, self.height)
        for name, focal in (("fx", fx), ("fy", fy)):
            if not OPTIONS.min_focal_ratio * size <= focal <= OPTIONS.max_focal_ratio * size:
                raise InvalidCameraError(
                    f"{name} = {focal:g} px can't belong to an image of {self.width} x {self.height} pixels: a lens "
                    "sees between 5 and 150 degrees. Give focal lengths in pixels of this very image, not in "
                    "millimetres, and not an angle of view."
                )
        if not 1.0 / OPTIONS.max_pixel_aspect_ratio <= fx / fy <= OPTIONS.max_pixel_aspect_ratio:
            raise InvalidCameraError(f"fx = {fx:g} and fy = {fy:g} differ by more than a factor of two.")
        offsets = abs(cx - self.width / 2) / self.width, abs(cy - self.height / 2) / self.height
        if max(offsets) > OPTIONS.max_principal_point_offset_ratio:
            raise InvalidCameraError(
                f"The principal point ({cx:g}, {cy:g}) is far from the centre of an image of "
                f"{self.width} x {self.height} pixels: give the intrinsics of this very image."
            )
        if any(abs(k) > OPTIONS.max_distortion for k in self.params[4:]):
            raise InvalidCameraError(
                f"A distortion coefficient above {OPTIONS.max_distortion:g} belongs to no real lens."
            )

    @staticmethod
    def from_values(values: ArrayLike, width: int, height: int) -> Camera:
        """Return the camera of `fx fy cx cy [k1 k2 p1 p2 [k3]]`; the number of values determines its model."""
        v = [float(x) for x in np.asarray(values, dtype=np.float64).reshape(-1)]
        if len(v) == 4:
            return Camera("PINHOLE", width, height, tuple(v))
        if len(v) == 8:
            return Camera("OPENCV", width, height, tuple(v))
        if len(v) == 9:
            return Camera("FULL_OPENCV", width, height, (*v, 0.0, 0.0, 0.0))
        raise InvalidCameraError(
            f"Intrinsics are fx,fy,cx,cy[,k1,k2,p1,p2[,k3]]: 4, 8 or 9 numbers, got {len(v)}."
        )

    @property
    def K(self) -> Array:
        """The calibration matrix (3, 3) (A eq. 10)."""
        fx, fy, cx, cy = self.params[:4]
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])

    @property
    def focal_px(self) -> float:
        """The mean focal length in pixels."""
        return 0.5 * (self.params[0] + self.params[1])

    @property
    def principal_point_px(self) -> Array:
        """The pixel (2,) on the optical axis."""
        return np.array(self.params[2:4])

    @property
    def distortion(self) -> Array:
        """The distortion coefficients in OpenCV's order: none, 4 or 8."""
        return np.array(self.params[4:], dtype=np.float64)

    @property
    def is_distorted(self) -> bool:
        """Whether any distortion coefficient is not zero (a fisheye always is)."""
        return self.model == "OPENCV_FISHEYE" or bool(np.any(self.distortion != 0))

    def scaled_to(self, width: int, height: int) -> Camera:
        """Return the camera of the resampled image; raises `InvalidCameraError` for another aspect ratio."""
        if (width, height) == (self.width, self.height):
            return self
        sx, sy = width / self.width, height / self.height
        if abs(sx / sy - 1) > OPTIONS.max_aspect_difference_ratio:
            raise InvalidCameraError(
                f"The camera is for {self.width} x {self.height} pixels, the image has {width} x {height}: "
                "another aspect ratio, so a crop, for which these intrinsics don't hold."
            )
        fx, fy, cx, cy = self.params[:4]
        # The pixel centres are at integers, so the image's corner, which keeps its place, is at (-0.5, -0.5).
        scaled = (fx * sx, fy * sy, (cx + 0.5) * sx - 0.5, (cy + 0.5) * sy - 0.5)
        return Camera(self.model, width, height, (*scaled, *self.params[4:]))

    def normalize(self, points_px: ArrayLike) -> Array:
        """Return undistorted image-plane coordinates (n, 2) of pixels (n, 2) (A eq. 5, lens removed)."""
        points = np.asarray(points_px, dtype=np.float64).reshape(-1, 2)
        if not self.is_distorted or len(points) == 0:
            fx, fy, cx, cy = self.params[:4]
            return np.asarray((points - [cx, cy]) / [fx, fy])
        if self.model == "OPENCV_FISHEYE":
            out = cv2.fisheye.undistortPoints(points[:, None], self.K, self.distortion)
        else:
            criteria = (
                cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER,
                OPTIONS.undistortion_iterations,
                OPTIONS.undistortion_tolerance,
            )
            out = cv2.undistortPointsIter(
                points[:, None], self.K, self.distortion, np.eye(3), np.eye(3), criteria
            )
        return np.asarray(out[:, 0], dtype=np.float64)

    def undistort(self, points_px: ArrayLike) -> Array:
        """Return the pixels (n, 2), for pixels (n, 2), of the pinhole camera with the same K."""
        fx, fy, cx, cy = self.params[:4]
        return np.asarray(self.normalize(points_px) * [fx, fy] + [cx, cy])

    def project(self, points_in_camera: ArrayLike) -> Array:
        """Return the pixels (n, 2) of camera-frame points (n, 3); NaN for points not in view.

        A point is not in view when it is behind the camera, or so far from the optical axis that the lens model
        folds back. Source: A eq. 10, B eq. 7, C eq. 4.2.1.
        """
        points = np.asarray(points_in_camera, dtype=np.float64).reshape(-1, 3)
        out = np.full((len(points), 2), np.nan)
        in_view = self._in_view(points)
        seen = points[in_view]
        if self.is_distorted and len(seen):
            out[in_view] = self._opencv_projection(seen)[0]
        else:
            fx, fy, cx, cy = self.params[:4]
            out[in_view] = seen[:, :2] / seen[:, 2:] * [fx, fy] + [cx, cy]
        return out

    def projection_jacobian(self, points_in_camera: ArrayLike) -> tuple[Array, Array]:
        """Return the pixels (n, 2) of camera-frame points (n, 3), and their derivatives (n, 2, 3) by them.

        The derivatives are in px/m. NaN for points not in view.
        """
        points = np.asarray(points_in_camera, dtype=np.float64).reshape(-1, 3)
        pixels, by_point = np.full((len(points), 2), np.nan), np.full((len(points), 2, 3), np.nan)
        in_view = self._in_view(points)
        if in_view.any():
            pixels[in_view], flat = self._opencv_projection(points[in_view])
            by_point[in_view] = flat.reshape(-1, 2, 3)
        return pixels, by_point

    def _opencv_projection(self, points: Array) -> tuple[Array, Array]:
        """Return the pixels (n, 2) of points (n, 3) in view, and their derivatives (2n, 3) by the points."""
        zero = np.zeros(3)
        # OpenCV gives the derivative by its translation; at the identity rotation that by the point is the same.
        if self.model == "OPENCV_FISHEYE":
            pixels, jacobian = cv2.fisheye.projectPoints(points[:, None], zero, zero, self.K, self.distortion)
            by_point = jacobian[:, 11:14]
        else:
            pixels, jacobian = cv2.projectPoints(points, zero, zero, self.K, self.distortion)
            by_point = jacobian[:, 3:6]
        return np.asarray(pixels[:, 0], dtype=np.float64), np.asarray(by_point, dtype=np.float64)

    def _in_view(self, points: Array) -> NDArray[np.bool_]:
        """Return which points (n, 3) are in front of the camera and within the fold of the lens model."""
        fold = _fold_radius(self.model, self.params[4:])
        with np.errstate(invalid="ignore"):
            front = points[:, 2] > MIN_DEPTH
            if np.isinf(fold):
                return np.asarray(front)
            return np.asarray(front & (np.hypot(points[:, 0], points[:, 1]) < fold * points[:, 2]))

    def unproject(self, points_px: ArrayLike, depth_m: ArrayLike) -> Array:
        """Return camera-frame points (n, 3) of pixels (n, 2) at z-depths (n,) in metres.

        Source: A eq. 5-6, C eq. 4.2.2.
        """
        z = np.asarray(depth_m, dtype=np.float64).reshape(-1, 1)
        return np.hstack([self.normalize(points_px) * z, z])

    def contains(self, points_px: ArrayLike) -> NDArray[np.bool_]:
        """Return which of the pixels (n, 2) lie inside the image."""
        p = np.asarray(points_px, dtype=np.float64).reshape(-1, 2)
        with np.errstate(invalid="ignore"):
            inside = (p >= -0.5) & (p <= np.array([self.width, self.height]) - 0.5)
        return np.asarray(inside.all(axis=1))


def as_shares(params: Sequence[float], width: int, height: int) -> str | None:
    """Return the sentence for intrinsics that are shares of an image's width and height in place of pixels, None for
    others."""
    fx, fy, cx, cy = params[:4]
    # In pixels a principal point this near to the corner is none.
    if not (0 < cx < 1 and 0 < cy < 1 and max(fx, fy) <= OPTIONS.max_focal_ratio):
        return None
    return (
        f"The intrinsics {fx:g}, {fy:g}, {cx:g}, {cy:g} seem to be shares of the image's width and height; give "
        f"pixels: multiply fx and cx by {width}, fy and cy by {height}."
    )


def off_centre_ratio(cx: float, cy: float, width: float, height: float) -> float:
    """Return how far a principal point is from the centre of an image, relative to the image's size."""
    return max(abs(cx + 0.5 - width / 2) / width, abs(cy + 0.5 - height / 2) / height)


@lru_cache(maxsize=256)
def _fold_radius(model: str, distortion: tuple[float, ...]) -> float:
    """Return the distance from the axis, at z = 1, at which the distorted radius of a lens model starts to decrease.

    A fitted polynomial is not valid there: it would project points far outside the view into the image. Infinity for
    a model that never folds.
    """
    if not any(distortion):
        return float("inf")
    if model == "OPENCV_FISHEYE":
        angle = np.linspace(0.0, np.pi / 2, OPTIONS.fisheye_fold_samples)[:-1]
        radius, distorted = np.tan(angle), angle * np.polyval([*distortion[::-1], 1.0], angle**2)
    else:
        k1, k2, k3, k4, k5, k6 = (*distortion[:2], *distortion[4:], 0.0, 0.0, 0.0, 0.0)[:6]
        radius = np.linspace(0.0, OPTIONS.max_fold_tangent, OPTIONS.fold_samples)
        squared = radius**2
        divisor = np.polyval([k6, k5, k4, 1.0], squared)
        distorted = (
            radius * np.polyval([k3, k2, k1, 1.0], squared) / np.where(divisor > 1e-6, divisor, np.nan)
        )
    # The negated comparison also counts a NaN, beyond a pole of the rational model, as a fold.
    folds = ~(np.diff(distorted) > 0)
    return float(radius[np.argmax(folds)]) if folds.any() else float("inf")
