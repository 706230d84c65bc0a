"""The radial distortion of a scan's camera, estimated from its own views and their depth where it is not stated."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from app.engine.mapping.sensor_sample import OPTIONS as SAMPLE_OPTIONS
from app.engine.mapping.sensor_sample import every_nth
from app.engine.maps.points import View, close_matches, nearby_views, points_from_depth
from app.engine.progress import NoProgress, Progress, map_in_order
from app.geometry.camera import Camera
from app.geometry.lens import Lens, PairTerms, SharedPoints, fit_lens
from app.limits import limit
from app.vision.features import LocalFeatureExtractor


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanLensOptions:
    """Which pairs of frames a lens is fitted to, and when its coefficient is significant."""

    max_other_views: int = limit(
        6,
        "Largest number of views that each keyframe is compared with.",
        chosen="By hand: more pairs of the same keyframe add little to one coefficient.",
    )
    min_shared_points: int = limit(
        20,
        "Least number of matched points of a pair of frames.",
        chosen="By hand: fewer points determine the pair's relative pose and leave little for the lens.",
    )
    min_pairs: int = limit(
        10,
        "Least number of pairs of frames that a lens is fitted to.",
        chosen="By hand; no measurement is recorded.",
    )
    min_coefficient: float = limit(
        0.005,
        "Smallest absolute radial coefficient k1 that is taken for a lens.",
        chosen="By hand: less is within the errors of a scan; it moves the corners of an image of 640 pixels and "
        "62 degrees by one pixel.",
    )
    min_sigmas: float = limit(
        5.0,
        "Least ratio of the coefficient to its standard deviation.",
        chosen="By hand; no measurement is recorded.",
    )
    scan_error_sigma: float = limit(
        0.003,
        "Standard deviation of the coefficient by errors of the scan that the fit does not see.",
        chosen="Measured: coefficients from different parts of one scan differ by about this "
        "(`roomfix evaluate RedKitchen --database ...`, docs/features.md, The lens).",
    )


OPTIONS = ScanLensOptions()


def learn_lens(
    views: Mapping[int, View],
    keyframes: Sequence[int],
    camera: Camera,
    extractor: LocalFeatureExtractor,
    executor: Executor,
    progress: Progress,
) -> Lens | None:
    """Return the lens of a scan whose camera is given as a pinhole; `keyframes` are rows of `views`.

    Its coefficient is 0 where the views show that there is no distortion. None where they don't determine it, or
    where the camera's distortion is stated.
    """
    if camera.model != "PINHOLE":
        return None
    rows = sorted(views)
    poses = [views[row].world_from_camera for row in rows]
    sampled = every_nth(keyframes, SAMPLE_OPTIONS.max_keyframes)

    def shared(row: int) -> list[SharedPoints]:
        near = nearby_views(views[row].world_from_camera, poses)
        others = [views[rows[i]] for i in every_nth(near, OPTIONS.max_other_views)]
        return _shared(views[row], others, camera, extractor)

    found = map_in_order(executor, shared, sampled, "check_lens", progress)
    pairs = [pair for of_keyframe in found for pair in of_keyframe]
    if len(pairs) < OPTIONS.min_pairs:
        return None

    def run(eliminate: Callable[[slice], list[PairTerms]], slices: list[slice]) -> list[list[PairTerms]]:
        # Without reports: a step takes less time than a report to a database.
        return list(map_in_order(executor, eliminate, slices, "check_lens", NoProgress()))

    lens = fit_lens(pairs, camera, run)
    least_significant = OPTIONS.min_sigmas * lens.sigma
    if abs(lens.coefficient) > max(OPTIONS.min_coefficient, least_significant):
        return Lens(lens.coefficient, float(np.hypot(lens.sigma, OPTIONS.scan_error_sigma)))
    return Lens(0.0, OPTIONS.min_coefficient) if least_significant < OPTIONS.min_coefficient else None


def _shared(
    view: View, others: Sequence[View], camera: Camera, extractor: LocalFeatureExtractor
) -> list[SharedPoints]:
    """Return the points that a view shares with each of the others, those with too few left out."""
    own = points_from_depth(view, camera)
    depth_m = view.depth_m[view.depth_m > 0].astype(np.float64)
    pairs = []
    for other in others:
        a, b = close_matches(own, other, camera, extractor.ratio, extractor.binary)
        if len(a) >= OPTIONS.min_shared_points:
            pairs.append(
                SharedPoints(
                    own.features.keypoints_px[a].astype(np.float64),
                    depth_m[a],
                    other.features.keypoints_px[b].astype(np.float64),
                    other.world_from_camera.inverse() @ view.world_from_camera,
                )
            )
    return pairs
