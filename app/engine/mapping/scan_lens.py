"""The lens of a scan's camera, where the scan doesn't state it: its own views, with their depth, show it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor

import numpy as np

from app.engine.maps.points import View, close_matches, nearby_views, points_from_depth
from app.engine.progress import Progress, map_in_order
from app.geometry.camera import Camera
from app.geometry.lens import Lens, SharedPoints, fit_lens
from app.vision.features import LocalFeatureExtractor

# So many keyframes, each with so many others, tell all there is to know.
MAX_KEYFRAMES, MAX_OTHERS = 40, 6
# Frames that share less say little about the lens and much about their poses.
MIN_SHARED = 20
MIN_PAIRS = 10
# Less is within what a scan's errors can do: one pixel of 640 at the corners of a picture of 62 degrees.
SMALLEST_COEFFICIENT = 0.005
MIN_SIGMAS = 5.0
# What a scan's other errors do to it: parts of one scan differ by so much.
LEAST_SIGMA = 0.003


def learn_lens(
    views: Mapping[int, View],
    keyframes: Sequence[int],
    camera: Camera,
    extractor: LocalFeatureExtractor,
    executor: Executor,
    progress: Progress,
) -> Lens | None:
    """Return the lens that the frames of a pinhole were taken through; `keyframes` are rows of `views`.

    A coefficient of 0 where the views show that there is none; None where they can't tell, or the distortion is stated.
    """
    if camera.model != "PINHOLE":
        return None
    rows = sorted(views)
    poses = [views[row].world_from_camera for row in rows]
    asked = list(keyframes)[:: max(1, -(-len(keyframes) // MAX_KEYFRAMES))]

    def shared(row: int) -> list[SharedPoints]:
        near = nearby_views(views[row].world_from_camera, poses)
        others = [views[rows[i]] for i in near[:: max(1, -(-len(near) // MAX_OTHERS))]]
        return _shared(views[row], others, camera, extractor)

    found = map_in_order(executor, shared, asked, "check_lens", progress)
    pairs = [pair for some in found for pair in some]
    if len(pairs) < MIN_PAIRS:
        return None
    lens = fit_lens(pairs, camera)
    if abs(lens.coefficient) > max(SMALLEST_COEFFICIENT, MIN_SIGMAS * lens.sigma):
        return Lens(lens.coefficient, float(np.hypot(lens.sigma, LEAST_SIGMA)))
    return Lens(0.0, SMALLEST_COEFFICIENT) if MIN_SIGMAS * lens.sigma < SMALLEST_COEFFICIENT else None


def _shared(
    view: View, others: Sequence[View], camera: Camera, extractor: LocalFeatureExtractor
) -> list[SharedPoints]:
    own = points_from_depth(view, camera)
    depth_m = view.depth_m[view.depth_m > 0].astype(np.float64)
    pairs = []
    for other in others:
        a, b = close_matches(own, other, camera, extractor.ratio, extractor.binary)
        if len(a) >= MIN_SHARED:
            pairs.append(
                SharedPoints(
                    own.features.keypoints_px[a].astype(np.float64),
                    depth_m[a],
                    other.features.keypoints_px[b].astype(np.float64),
                    other.world_from_camera.inverse() @ view.world_from_camera,
                )
            )
    return pairs
