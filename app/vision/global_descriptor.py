"""The global descriptor: one vector for a whole image, by an ONNX model."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidInputError
from app.limits import limit
from app.vision.images import Rgb
from app.vision.local_features import MODELS_DIR
from app.vision.onnx_session import model_sha256, open_session

DEFAULT_MODEL = MODELS_DIR / "global_descriptor.onnx"


@dataclass(frozen=True, slots=True, kw_only=True)
class GlobalDescriptorOptions:
    """The size of the images that are described."""

    width_px: int = limit(
        320,
        "Width to which an image is resized.",
        chosen="By hand: the model was made for 320 x 240 pixels (app/models/global_descriptor.md).",
    )
    height_px: int = limit(
        240,
        "Height to which an image is resized.",
        chosen="By hand: the model was made for 320 x 240 pixels (app/models/global_descriptor.md).",
    )


OPTIONS = GlobalDescriptorOptions()


class GlobalDescriptor:
    """Describes images by an ONNX model: (1, 3, height, width) float32 RGB, (x - 127) / 128, to (1, d).

    Any model with these inputs and outputs can be used; `sha256` identifies it and `size` is its d. Raises
    `InvalidInputError` for a file that is missing or is not such a model.
    """

    def __init__(
        self,
        path: Path = DEFAULT_MODEL,
        width: int = OPTIONS.width_px,
        height: int = OPTIONS.height_px,
        threads: int = 1,
    ) -> None:
        if not path.is_file():
            raise InvalidInputError(f"There is no global descriptor model at {path}.")
        self.sha256 = model_sha256(path)
        self._size_px = (width, height)
        try:
            self._session = open_session(path, threads)
            self._input = self._session.get_inputs()[0].name
            self.size = len(self.describe(np.zeros((height, width, 3), np.uint8)))
        except Exception as error:  # ONNX Runtime's exceptions have no common base class
            raise InvalidInputError(
                f"{path} is not a model that describes {width} x {height} images."
            ) from error

    def describe(self, rgb: Rgb) -> NDArray[np.float32]:
        """Return the descriptor (d,), of unit length, of an RGB image (height, width, 3)."""
        small = cv2.resize(rgb, self._upright_size(rgb), interpolation=cv2.INTER_AREA)
        blob = ((small.astype(np.float32) - 127.0) / 128.0).transpose(2, 0, 1)[None]
        (output,) = self._session.run(None, {self._input: np.ascontiguousarray(blob)})
        vector = np.asarray(output, dtype=np.float32).reshape(-1)
        return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-12), dtype=np.float32)

    def _upright_size(self, rgb: Rgb) -> tuple[int, int]:
        width, height = self._size_px
        # A portrait picture keeps its aspect ratio if the model's input size is not fixed.
        if rgb.shape[0] > rgb.shape[1] and not isinstance(self._session.get_inputs()[0].shape[2], int):
            return height, width
        return width, height
