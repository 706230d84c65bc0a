"""One picture that is asked of one map, and what is known of it before it is matched."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.stage_timer import clock_s
from app.geometry.camera import Camera
from app.geometry.focal import ApproximateCamera
from app.vision.images import Gray, Rgb, to_gray

# The stages before the pose.
STAGES = ("describe", "retrieve", "match")


@dataclass(frozen=True, slots=True, kw_only=True)
class Query:
    """A picture (height, width, 3) with its grey version, its camera as far as it is known, and its restrictions.

    `allowed` are the keyframes that may be retrieved, None for all; `upright` says that the picture needs no turn;
    `spent_s` collects the seconds of the stages before the pose, since `started_s` on the clock of `clock_s`.
    """

    rgb: Rgb
    gray: Gray
    known: Camera | ApproximateCamera | None
    allowed: NDArray[np.int64] | None
    upright: bool
    started_s: float
    spent_s: dict[str, float]

    @staticmethod
    def of(
        rgb: Rgb,
        known: Camera | ApproximateCamera | None,
        allowed: NDArray[np.int64] | None = None,
        upright: bool = False,
    ) -> Query:
        """Return the query for an RGB image (height, width, 3); its time starts here."""
        started_s = clock_s()
        return Query(
            rgb=rgb,
            gray=to_gray(rgb),
            known=known,
            allowed=allowed,
            upright=upright,
            started_s=started_s,
            spent_s=dict.fromkeys(STAGES, 0.0),
        )

    @property
    def timings_ms(self) -> dict[str, float]:
        """Milliseconds by stage so far; what no other stage took is the pose's."""
        pose_s = clock_s() - self.started_s - sum(self.spent_s.values())
        return {stage: 1e3 * spent_s for stage, spent_s in {**self.spent_s, "pose": pose_s}.items()}

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the picture."""
        height, width = self.gray.shape
        return width, height
