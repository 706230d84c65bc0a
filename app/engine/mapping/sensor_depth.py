"""The systematic error of a scan's depth sensor, learned by comparing it with depths triangulated from other views."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.sensor_sample import OPTIONS as SAMPLE_OPTIONS
from app.engine.mapping.sensor_sample import every_nth
from app.engine.maps.points import View, observations_by, points_from_depth
from app.engine.progress import Progress, map_in_order
from app.geometry.camera import Camera
from app.geometry.depth_response import DepthResponse, fit_depth_response
from app.geometry.ray_depth import refine_depth_along_rays
from app.limits import limit
from app.vision.features import LocalFeatureExtractor

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorDepthOptions:
    """Which triangulated depths the depth sensor is compared with."""

    prior_sigma_ratio: float = limit(
        0.1,
        "Standard deviation of the sensor's depth, divided by the depth, as the prior of the triangulation.",
        chosen="By hand: wide, because the sensor is what is measured; it keeps false matches from moving a depth far.",
    )
    min_views: int = limit(
        3,
        "Least number of other views that saw a point whose depth is compared.",
        chosen="By hand; no measurement is recorded.",
    )
    max_median_error_px: float = limit(
        3.0,
        "Largest median reprojection error, in those views, of a point whose depth is compared.",
        chosen="By hand; no measurement is recorded.",
    )
    max_sigma_ratio: float = limit(
        0.03,
        "Largest standard deviation of a triangulated depth, divided by the depth.",
        chosen="By hand; no measurement is recorded.",
    )


OPTIONS = SensorDepthOptions()


def learn_depth_response(
    keyframe_views: Sequence[View],
    seen_by: Sequence[Sequence[View]],
    camera: Camera,
    extractor: LocalFeatureExtractor,
    executor: Executor,
    progress: Progress,
) -> DepthResponse:
    """Return the response of a scan's depth sensor; `seen_by` are the other views that see each of the views."""
    pairs = every_nth(list(zip(keyframe_views, seen_by, strict=True)), SAMPLE_OPTIONS.max_keyframes)

    def known(pair: tuple[View, Sequence[View]]) -> tuple[Array, Array, Array, Array]:
        return _known_depths(*pair, camera, extractor)

    found = list(map_in_order(executor, known, pairs, "check_sensor", progress))
    shown_m, image_plane, depth_m, sigma = (np.concatenate(part) for part in zip(*found, strict=True))
    return fit_depth_response(shown_m, image_plane, depth_m, sigma)


def corrected(view: View, response: DepthResponse, camera: Camera) -> View:
    """Return a view with the depths that its sensor should have shown."""
    image_plane = camera.normalize(view.features.keypoints_px)
    depth_m = response.correct(view.depth_m.astype(np.float64), image_plane)
    return replace(view, depth_m=depth_m.astype(np.float32))


def _known_depths(
    view: View, others: Sequence[View], camera: Camera, extractor: LocalFeatureExtractor
) -> tuple[Array, Array, Array, Array]:
    """Return the sensor's depths (n,) of a view in metres, their places on the image plane (n, 2), and the depths (n,)
    by the other views alone, with the standard deviations (n,) of their logarithms."""
    own = points_from_depth(view, camera)
    shown_m = view.depth_m[view.depth_m > 0].astype(np.float64)
    rays = camera.unproject(own.features.keypoints_px, np.ones(len(shown_m)))
    seen = observations_by(others, own, camera, extractor.ratio, extractor.binary)
    in_world = rays @ view.world_from_camera.rotation.T
    refined = refine_depth_along_rays(
        in_world, view.world_from_camera.translation, shown_m, seen, prior_sigma=OPTIONS.prior_sigma_ratio
    )
    total = (refined.depth_m / refined.sigma_m) ** 2
    information = total - 1.0 / OPTIONS.prior_sigma_ratio**2
    good = (refined.views >= OPTIONS.min_views) & (information > 1.0 / OPTIONS.max_sigma_ratio**2)
    good &= ~(refined.error_px > OPTIONS.max_median_error_px)
    # The refined logarithm is the mean of sensor and views, weighted by information: subtract the sensor's part.
    moved = np.log(refined.depth_m[good] / shown_m[good]) * total[good] / information[good]
    return shown_m[good], rays[good, :2], shown_m[good] * np.exp(moved), 1.0 / np.sqrt(information[good])
