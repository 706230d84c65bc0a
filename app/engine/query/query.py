"""One picture that is asked of one map, and what is known of it before it is matched."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from app.engine.stage_timer import StageTimer
from app.geometry.camera import Camera
from app.geometry.focal import ApproximateCamera
from app.vision.images import Gray, Rgb, to_gray


@dataclass(frozen=True, slots=True, kw_only=True)
class Query:
    """A picture (height, width, 3) with its grey version, its camera as far as it is known, and its restrictions.

    `allowed` are the keyframes that may be retrieved, None for all; `upright` says that the picture needs no turn;
    `timer` collects how long each stage takes.
    """

    rgb: Rgb
    gray: Gray
    known: Camera | ApproximateCamera | None
    allowed: NDArray[np.int64] | None = None
    upright: bool = False
    timer: StageTimer = field(default_factory=StageTimer)

    @staticmethod
    def of(
        rgb: Rgb,
        known: Camera | ApproximateCamera | None,
        allowed: NDArray[np.int64] | None = None,
        upright: bool = False,
    ) -> Query:
        """Return the query for an RGB image (height, width, 3); its timer starts here."""
        timer = StageTimer()
        return Query(rgb=rgb, gray=to_gray(rgb), known=known, allowed=allowed, upright=upright, timer=timer)

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the picture."""
        height, width = self.gray.shape
        return width, height
