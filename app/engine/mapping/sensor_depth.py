"""What a scan's own views say about its depth sensor: where they triangulate well, the sensor is compared with them."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.points import View, observations_by, points_from_depth
from app.engine.progress import Progress, map_in_order
from app.geometry.camera import Camera
from app.geometry.depth_response import DepthResponse, fit_depth_response
from app.geometry.ray_depth import refine_depth_along_rays
from app.vision.features import LocalFeatureExtractor

Array = NDArray[np.float64]

# So many keyframes of a scan tell all there is to know.
MAX_KEYFRAMES = 40
# The sensor's say where it is itself in question; it keeps wrong matches from running away.
LOOSE_SIGMA = 0.1
# A depth is known when so many views agree on it, this well, and leave no more doubt than this share of it.
MIN_VIEWS, MAX_ERROR_PX, MAX_SIGMA = 3, 3.0, 0.03


def learn_depth_response(
    keyframes: Sequence[View],
    seen_by: Sequence[Sequence[View]],
    camera: Camera,
    extractor: LocalFeatureExtractor,
    executor: Executor,
    progress: Progress,
) -> DepthResponse:
    """Return the response of the sensor of a scan's keyframes, each seen by the given other views."""
    step = max(1, -(-len(keyframes) // MAX_KEYFRAMES))
    pairs = list(zip(keyframes, seen_by, strict=True))[::step]

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
    """Return what the sensor shows (n,), where on the image plane (n, 2), and the depths (n,) by the other views
    alone, with their sigmas (n,) as shares of them."""
    own = points_from_depth(view, camera)
    shown_m = view.depth_m[view.depth_m > 0].astype(np.float64)
    rays = camera.unproject(own.features.keypoints_px, np.ones(len(shown_m)))
    seen = observations_by(others, own, camera, extractor.ratio, extractor.binary)
    in_world = rays @ view.world_from_camera.rotation.T
    refined = refine_depth_along_rays(
        in_world, view.world_from_camera.translation, shown_m, seen, prior_sigma=LOOSE_SIGMA
    )
    total = (refined.depth_m / refined.sigma_m) ** 2
    information = total - 1.0 / LOOSE_SIGMA**2
    good = (refined.views >= MIN_VIEWS) & (information > 1.0 / MAX_SIGMA**2)
    good &= ~(refined.error_px > MAX_ERROR_PX)
    # The refined logarithm is the mean of both, weighed by information: take the sensor's share out again.
    moved = np.log(refined.depth_m[good] / shown_m[good]) * total[good] / information[good]
    return shown_m[good], rays[good, :2], shown_m[good] * np.exp(moved), 1.0 / np.sqrt(information[good])
