"""Pictures whose faces can't be recognized any more."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from app.limits import limit
from app.vision.faces.detector import Boxes, FaceDetector
from app.vision.images import Rgb, decode_image

PNG_MAGIC = b"\x89PNG"


@dataclass(frozen=True, slots=True, kw_only=True)
class BlurOptions:
    """How faces are blurred."""

    margin_ratio: float = limit(
        0.2,
        "What is blurred around a face, over its size.",
        chosen="By hand: hair and ears, by which people are recognized too.",
    )
    cells: int = limit(
        5,
        "Cells across a face that are left of it.",
        chosen="By hand: eyes and mouth are a cell each, which no longer tells people apart.",
    )
    jpeg_quality: int = limit(
        95, "JPEG quality of a picture that was changed.", chosen="By hand: as good as what cameras write."
    )


OPTIONS = BlurOptions()


def with_blurred_faces(data: bytes, detector: FaceDetector) -> bytes | None:
    """Return an image file's bytes with its faces blurred, or None when it shows none.

    A PNG stays one, others become JPEG; the picture is upright and has no metadata. Raises as `decode_image`.
    """
    rgb = decode_image(data)
    boxes = detector.find(rgb)
    if not len(boxes):
        return None
    bgr = cv2.cvtColor(blurred(rgb, boxes), cv2.COLOR_RGB2BGR)
    if data.startswith(PNG_MAGIC):
        return cv2.imencode(".png", bgr)[1].tobytes()
    return cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, OPTIONS.jpeg_quality])[1].tobytes()


def blurred(rgb: Rgb, boxes: Boxes) -> Rgb:
    """Return a picture in which boxes (n, 4), x, y, width, height in pixels, are a few cells of one colour each."""
    changed = rgb.copy()
    height, width = rgb.shape[:2]
    for x, y, w, h in boxes:
        dx, dy = OPTIONS.margin_ratio * w, OPTIONS.margin_ratio * h
        left, top = max(0, int(x - dx)), max(0, int(y - dy))
        right, bottom = min(width, int(np.ceil(x + w + dx))), min(height, int(np.ceil(y + h + dy)))
        if right <= left or bottom <= top:
            continue
        face = changed[top:bottom, left:right]
        cells = cv2.resize(face, (OPTIONS.cells, OPTIONS.cells), interpolation=cv2.INTER_AREA)
        changed[top:bottom, left:right] = cv2.resize(
            cells, (right - left, bottom - top), interpolation=cv2.INTER_NEAREST
        )
    return changed
