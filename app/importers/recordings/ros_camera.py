"""The camera in a message of sensor_msgs/CameraInfo, of ROS 1 or ROS 2."""

from __future__ import annotations

from typing import Any

import numpy as np

from app.errors import InvalidScanError
from app.geometry.camera import Camera
from app.geometry.camera_hint import CameraHint, hint_of
from app.importers.scan_camera import camera_stated_in

FISHEYE = ("equidistant", "fisheye", "kannala_brandt4")
# Coefficients of the rational model in OpenCV's order; what follows them is a prism and a tilt.
_RATIONAL = 8


def camera_of(message: Any, *, is_rectified: bool) -> CameraHint | None:
    """Return the camera of a message, None for one that was never calibrated.

    Rectified pictures have the matrix P and no lens. Raises `InvalidScanError` for a lens that no camera here has.
    """
    K, D, P = (_array(message, name) for name in ("k", "d", "p"))
    if is_rectified:
        K, D = P.reshape(3, 4)[:, :3].ravel(), np.zeros(0)
    values = tuple(float(K[i]) for i in (0, 4, 2, 5))
    if not values[0] > 0:
        return None
    if not np.any(D):
        return CameraHint(values=values)
    model = str(message.distortion_model).lower()
    if model in FISHEYE and len(D) >= 4:
        return _whole("OPENCV_FISHEYE", message, (*values, *D[:4].tolist()))
    if model not in FISHEYE and len(D) in (4, 5):
        return CameraHint(values=(*values, *D.tolist()))
    if model not in FISHEYE and len(D) >= _RATIONAL and not np.any(D[_RATIONAL:]):
        return _whole("FULL_OPENCV", message, (*values, *D[:_RATIONAL].tolist()))
    raise InvalidScanError(
        f"The bag's camera has a lens of the model {model or '?'} with {len(D)} numbers, which is not read: give "
        "`camera` in the options."
    )


def _array(message: Any, name: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    # ROS 1 has these fields in capitals.
    found = getattr(message, name) if hasattr(message, name) else getattr(message, name.upper())
    return np.asarray(found, dtype=np.float64).ravel()


def _whole(model: str, message: Any, params: tuple[float, ...]) -> CameraHint:
    with camera_stated_in("The bag's CameraInfo"):
        return hint_of(Camera(model, int(message.width), int(message.height), params))
