"""A POI's length by a plane sweep, for regions in which too few features match.

Once the relative pose is known, each length of the POI puts its region somewhere in the phone's image. The length at
which the descriptors of both images agree best is the POI's, where no other length comes near.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.geometry.triangulation import homogeneous
from app.limits import limit
from app.vision.dense_descriptors import DenseDescriptors

Array = NDArray[np.float64]

BY_HAND = "By hand, looking at 64 sweeps of pairs of RedKitchen frames (docs/figures/evaluate-anchors.md)."


@dataclass(frozen=True, slots=True, kw_only=True)
class PoiSweepOptions:
    """How a region is swept, and when its length is believed."""

    min_length_ratio: float = limit(
        0.3,
        "Least length that is tried, divided by the distance between both cameras.",
        chosen="By hand: nearer POIs are seen from opposite sides.",
    )
    step_px: float = limit(
        3.0,
        "Distance in the phone's image between two lengths that are tried.",
        chosen="By hand: less than half of a cell of the network.",
    )
    max_steps: int = limit(
        400, "Largest number of lengths that are tried.", chosen="By hand: bounds the time to some 50 ms."
    )
    weight_sigma_ratio: float = limit(
        0.2,
        "Standard deviation of the weight of a region's points around its middle, divided by the region's size.",
        chosen="By hand: the distance to the middle was measured, and a region often shows more than one surface.",
    )
    min_visible_share: float = limit(
        0.6,
        "Least weight of the points that the phone's image must hold at a length.",
        chosen="By hand; no measurement is recorded.",
    )
    peak_px: float = limit(
        12.0,
        "Distance in the phone's image from the place of all within which a single point agrees with it.",
        chosen="By hand: one and a half cells of the network.",
    )
    min_margin: float = limit(
        0.01,
        "Difference of mean similarities below which the better one is not sure to be right.",
        chosen=BY_HAND,
    )
    sigma_per_spread: float = limit(
        0.7,
        "Standard deviation of the logarithm of a length for half of the spread of lengths that agree as well.",
        chosen="By hand: about that of an even distribution.",
    )
    min_support: float = limit(
        0.6,
        "Least weight of the points that agree best with the phone's image near the place of all.",
        chosen=BY_HAND,
    )
    base_log_sigma: float = limit(
        0.08, "Standard deviation of the logarithm of a length at best.", chosen=BY_HAND
    )
    sigma_px: float = limit(6.0, "Standard deviation of the place in the phone's image.", chosen=BY_HAND)


OPTIONS = PoiSweepOptions()


@dataclass(frozen=True, slots=True)
class RegionDescriptors:
    """Unit descriptors (n, d) at pixels (n, 2) of a monitoring frame, in the regions of its POIs."""

    points_px: NDArray[np.float32]
    descriptors: NDArray[np.float32]

    def take(self, rows: NDArray[np.bool_]) -> RegionDescriptors:
        """Return the descriptors of a mask (n,)."""
        return RegionDescriptors(self.points_px[rows], self.descriptors[rows])


@dataclass(frozen=True, slots=True)
class SweptLength:
    """The length along the ray to a region's middle, in the unit of the relative pose, and its logarithm's standard
    deviation."""

    length: float
    log_sigma: float


def sweep_region(
    region: RegionDescriptors,
    middle_px: Array,
    size_px: float,
    phone: DenseDescriptors,
    cameras: tuple[Camera, Camera],
    phone_from_monitor: Pose,
) -> SweptLength | None:
    """Return the length to a region's middle (2,), or None where no length stands out.

    The region, `size_px` large, is taken as a plane perpendicular to the ray to its middle. `cameras` are the
    monitoring camera and the phone's.
    """
    monitor_camera, phone_camera = cameras
    ray = _unit_rays(monitor_camera, middle_px[None])[0]
    inverses, places_px = _hypotheses(ray, phone, phone_camera, phone_from_monitor)
    if len(inverses) < 3 or len(region.points_px) == 0:
        return None
    points_px = region.points_px.astype(np.float64)
    rays = _unit_rays(monitor_camera, points_px)
    on_plane = rays / np.maximum(rays @ ray, 0.1)[:, None]
    directions = (
        on_plane @ phone_from_monitor.rotation.T + inverses[:, None, None] * phone_from_monitor.translation
    )
    seen_px, visible = _projected(directions.reshape(-1, 3), phone, phone_camera)
    similarity = np.einsum(
        "knd,nd->kn", phone.at(seen_px).reshape(len(inverses), len(rays), -1), region.descriptors
    )
    visible = visible.reshape(similarity.shape)
    weights = np.exp(
        -0.5 * (np.linalg.norm(points_px - middle_px, axis=1) / (OPTIONS.weight_sigma_ratio * size_px)) ** 2
    )
    weights /= max(weights.sum(), 1e-12)
    return _best_length(np.where(visible, similarity, 0.0), visible @ weights, weights, inverses, places_px)


def _best_length(
    similarity: Array, visible_share: Array, weights: Array, inverses: Array, places_px: Array
) -> SweptLength | None:
    """Return the length of the highest mean similarity, given similarities (k, n) and weights (n,), or None."""
    mean = np.where(visible_share >= OPTIONS.min_visible_share, similarity @ weights, -1.0)
    best = int(mean.argmax())
    if mean[best] <= 0 or inverses[best] <= 0:
        return None
    # What agrees nearly as well may be the place too, and its spread is part of what is not known.
    rivals = np.flatnonzero(mean >= mean[best] - OPTIONS.min_margin)
    if inverses[rivals[0]] <= 0:
        return None
    spread = 0.5 * float(np.log(inverses[rivals[-1]] / inverses[rivals[0]]))
    own_px = places_px[similarity.argmax(axis=0)]
    agreeing = (own_px >= places_px[rivals[0]] - OPTIONS.peak_px) & (
        own_px <= places_px[rivals[-1]] + OPTIONS.peak_px
    )
    if float(agreeing @ weights) < OPTIONS.min_support:
        return None
    parts = OPTIONS.base_log_sigma, OPTIONS.sigma_px / places_px[best], OPTIONS.sigma_per_spread * spread
    return SweptLength(1.0 / float(inverses[best]), float(np.linalg.norm(parts)))


def _hypotheses(
    ray: Array, phone: DenseDescriptors, camera: Camera, phone_from_monitor: Pose
) -> tuple[Array, Array]:
    """Return inverse lengths (k,) along a ray (3,), and how far (k,) each lies from infinity in the phone's image.

    They are `step_px` apart in the input of the phone's descriptors; lengths that it can't see are left out.
    """
    fine = np.linspace(0.0, 1.0 / OPTIONS.min_length_ratio, 2000)
    directions = phone_from_monitor.rotation @ ray + fine[:, None] * phone_from_monitor.translation
    seen_px, visible = _projected(directions, phone, camera)
    if not visible.any():
        return fine[:0], fine[:0]
    moved = np.linalg.norm(np.diff(phone.input_px(seen_px), axis=0), axis=1)
    moved[~(visible[1:] & visible[:-1])] = 0.0
    # Where the ray to infinity is not seen, the place counts from the first length that is.
    places_px = np.concatenate([[0.0], np.cumsum(moved)])
    step_px = max(OPTIONS.step_px, places_px[-1] / OPTIONS.max_steps)
    rows = np.unique(np.searchsorted(places_px, np.arange(0.0, places_px[-1] + 1e-9, step_px)))
    rows = rows[visible[rows]]
    return fine[rows], places_px[rows]


def _projected(directions: Array, phone: DenseDescriptors, camera: Camera) -> tuple[Array, NDArray[np.bool_]]:
    """Return the phone's pixels (n, 2) of directions (n, 3), and which its descriptors cover."""
    seen_px = camera.project(directions)
    in_view = np.asarray(np.isfinite(seen_px).all(axis=1))
    seen_px = np.where(in_view[:, None], seen_px, 0.0)
    return seen_px, np.asarray(in_view & phone.contains(seen_px))


def _unit_rays(camera: Camera, points_px: Array) -> Array:
    rays = homogeneous(camera.normalize(points_px))
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))
