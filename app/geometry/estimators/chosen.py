"""The robust estimators of this process: PoseLib's where it is installed, otherwise OpenCV's."""

from __future__ import annotations

from app.geometry.estimators.interface import Estimators
from app.geometry.estimators.opencv_estimators import OpenCvEstimators


def choose_estimators() -> Estimators:
    """Return the estimators by PoseLib, or those by OpenCV when PoseLib can't be imported."""
    try:
        from app.geometry.estimators.poselib_estimators import PoseLibEstimators
    except ImportError:  # There is no wheel of PoseLib for this machine, for example ARM64.
        return OpenCvEstimators()
    return PoseLibEstimators()


ESTIMATORS = choose_estimators()
