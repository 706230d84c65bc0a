"""The RGB-D paper's own limit: an answer by fewer than T_match matching points is none (A 2.1)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from app.engine.query.localization import Localization
from app.engine.query.localizer import Localizer
from app.geometry.camera import Camera
from app.vision.images import Rgb
from app.vision.keyframes import WANTED_MATCHES


class EnoughMatchesLocalizer:
    """Localizes as the localizer does that it is given, and refuses a pose from fewer than 50 matching points.

    Matching points are those that the fundamental matrix leaves: the paper finds pose errors small and stable from 50
    on, and sets that as the least number. The pose that was refused stays the answer's `candidate`.
    """

    def __init__(self, localizer: Localizer, wanted: float = WANTED_MATCHES) -> None:
        self._localizer = localizer
        self._wanted = wanted

    def localize(
        self, rgb: Rgb, camera: Camera | None, allowed: NDArray[np.int64] | None = None
    ) -> Localization:
        """Localize an RGB image (height, width, 3)."""
        found = self._localizer.localize(rgb, camera, allowed)
        if found.world_from_camera is None or found.evidence.matches >= self._wanted:
            return found
        return replace(found.refused("no_match"), candidate=found.world_from_camera)
