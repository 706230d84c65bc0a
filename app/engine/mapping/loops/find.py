"""Frames that see the same place: described, and the motions between them measured."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.frame_images import frame_rgb
from app.engine.mapping.loops.measure import Seen, measure_motion
from app.engine.mapping.loops.optimize import Loop
from app.engine.mapping.loops.places import Pair, pairs_to_compare
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import Progress, map_in_order
from app.geometry.depth import sample_depth
from app.importers.frames import Frame, Scan
from app.vision.images import to_gray

FEATURES = "sift"


@dataclass(slots=True, kw_only=True)
class Places:
    """Frames of a scan (n), each described when it is first needed: what it sees, and its global descriptor (d,)."""

    scan: Scan
    frames: Sequence[Frame]
    models: VisionModels
    executor: Executor
    progress: Progress
    _seen: dict[int, tuple[Seen, NDArray[np.float32]]] = field(default_factory=dict)

    def alike(self, near: NDArray[np.bool_]) -> list[Pair]:
        """Return the pairs of places that look most alike, among those of a mask (n, n)."""
        wanted = np.flatnonzero(near.any(axis=1)).tolist()
        self._describe(wanted)
        descriptors = np.stack([self._seen[place][1] for place in wanted])
        return [
            (wanted[i], wanted[j]) for i, j in pairs_to_compare(near[np.ix_(wanted, wanted)], descriptors)
        ]

    def motions(self, pairs: Sequence[Pair]) -> list[Loop]:
        """Return the measured motions of the pairs that see the same place."""
        self._describe(sorted({place for pair in pairs for place in pair}))
        binary = self.models.extractor(FEATURES).binary

        def measure(pair: Pair) -> Loop | None:
            a, b = (self._seen[place][0] for place in pair)
            a_from_b = measure_motion(a, b, self.scan.camera, binary)
            return None if a_from_b is None else Loop(*pair, a_from_b)

        found = map_in_order(self.executor, measure, pairs, "find_loops", self.progress)
        return [loop for loop in found if loop is not None]

    def _describe(self, wanted: Sequence[int]) -> None:
        missing = [place for place in wanted if place not in self._seen]
        found = map_in_order(self.executor, self._seen_by, missing, "describe_places", self.progress)
        self._seen.update(zip(missing, found, strict=True))

    def _seen_by(self, place: int) -> tuple[Seen, NDArray[np.float32]]:
        frame, extractor = self.frames[place], self.models.extractor(FEATURES)
        rgb = frame_rgb(self.scan, frame)
        features = extractor.extract(to_gray(rgb))
        depth_m = sample_depth(self.scan.depth_m(frame), features.keypoints_px).astype(np.float32)
        return Seen(features, depth_m), self.models.global_descriptor.describe(rgb)
