"""Triangulation of POIs: which matches lie in a POI's region, and its distance in the unit of the relative pose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.anchors.anchor import AnchorSpec, Poi
from app.engine.anchors.poi_sweep import SweptLength
from app.geometry.anchor_pose import PoiSight, scale_of_pois
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.geometry.triangulation import homogeneous, pixel_depths
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class PoiTriangulationOptions:
    """When a POI is triangulated, and the standard deviation of its length.

    That of the length's logarithm is the root of the sum of the squares of four parts.
    """

    min_region_matches: int = limit(
        4,
        "Least number of triangulated matches in a POI's region.",
        chosen="By hand: fewer have no meaningful scatter.",
    )
    max_log_scale_sigma: float = limit(
        0.25,
        "Largest standard deviation of the logarithm of a scale, of a POI alone and of an accepted fix.",
        chosen="Measured: `roomfix evaluate-anchors --demo DIR --count 100`, seeds 1 to 3 (docs/anchors.md, Figures).",
    )
    middle_ratio: float = limit(
        0.05,
        "Length added to a match's distance from the region's middle, whose inverse square weights the match, divided "
        "by the region's size.",
        chosen="By hand; no measurement is recorded.",
    )
    base_log_sigma: float = limit(
        0.06,
        "Standard deviation of a length's logarithm at best.",
        chosen="Measured on rendered pairs; the command is not recorded.",
    )
    log_sigma_per_scatter: float = limit(
        1.0,
        "Standard deviation of a length's logarithm for each unit of the matches' scatter.",
        chosen="Measured on rendered pairs; the command is not recorded.",
    )
    log_sigma_of_one_match: float = limit(
        1.0,
        "Standard deviation of a length's logarithm by a single match; it is divided by the number of matches.",
        chosen="Measured on rendered pairs; the command is not recorded.",
    )
    log_sigma_per_size: float = limit(
        0.3,
        "Standard deviation of a length's logarithm where the nearest match is as far from the region's middle as "
        "the region is large.",
        chosen="Measured on rendered pairs; the command is not recorded.",
    )


OPTIONS = PoiTriangulationOptions()


def region_in(poi: Poi, spec: AnchorSpec, camera: Camera) -> Array:
    """Return the corners (n, 2) of a POI's region in a frame's pixels, scaled from their own image size."""
    corners = np.array(poi.region_px, dtype=np.float64)
    own = spec.camera.camera
    if own is None:
        return corners
    scale = np.array([camera.width / own.width, camera.height / own.height])
    return np.asarray((corners + 0.5) * scale - 0.5)


def regions_in(spec: AnchorSpec, camera: Camera) -> list[Array]:
    """Return the corners (n, 2) of each POI's region in a frame's pixels."""
    return [region_in(poi, spec, camera) for poi in spec.pois]


def inside_region(points_px: Array, corners: Array) -> NDArray[np.bool_]:
    """Return which points (n, 2) lie inside a polygon (m, 2), by the even-odd rule."""
    inside = np.zeros(len(points_px), dtype=bool)
    u, v = points_px[:, 0], points_px[:, 1]
    for (u0, v0), (u1, v1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        crosses = (v0 > v) != (v1 > v)
        if crosses.any():
            with np.errstate(divide="ignore", invalid="ignore"):
                inside ^= crosses & (u < (u1 - u0) * (v - v0) / (v1 - v0) + u0)
    return inside


def centroid(corners: Array) -> Array:
    """Return the centroid (2,) of a polygon (n, 2), or the mean of its corners when it has no area."""
    following = np.roll(corners, -1, axis=0)
    cross = corners[:, 0] * following[:, 1] - following[:, 0] * corners[:, 1]
    if abs(cross.sum()) < 1e-9:
        return np.asarray(corners.mean(axis=0))
    return np.asarray(((corners + following) * cross[:, None]).sum(axis=0) / (3.0 * cross.sum()))


def lengths_along_rays(normalized: Array, phone_normalized: Array, phone_from_monitor: Pose) -> Array:
    """Return the lengths (n,) along the monitoring camera's rays (n, 2), triangulated with the phone's rays (n, 2)."""
    depths, _ = pixel_depths(normalized, phone_normalized, phone_from_monitor)
    return np.asarray(depths * np.linalg.norm(homogeneous(normalized), axis=1))


def scale_by_pois(
    spec: AnchorSpec, camera: Camera, monitor_px: Array, lengths_m: Array
) -> tuple[float, float] | None:
    """Return the logarithm of the scale of lengths (n,) at a monitoring frame's pixels (n, 2), and its standard
    deviation, by the measured distances of the POIs (C eq. 4.2.7); None where no POI is triangulated."""
    scale = scale_of_pois([sight for sight, _ in reliable_sights_of(spec, camera, monitor_px, lengths_m)])
    return None if scale is None else (scale.log_scale, scale.log_sigma)


def reliable_sights_of(
    spec: AnchorSpec,
    camera: Camera,
    monitor_px: Array,
    lengths: Array,
    sweep: Callable[[Array, float], SweptLength | None] | None = None,
) -> list[tuple[PoiSight, int]]:
    """Return the reliably triangulated POIs of an anchor, each as `triangulate_poi` does.

    `sweep` gives the length to a region's middle (2,), by the region's size, where matches give none or an unreliable
    one.
    """
    seen = []
    for poi in spec.pois:
        sight = triangulate_poi(poi, spec, camera, monitor_px, lengths)
        if sweep is not None and (sight is None or sight[0].log_sigma > OPTIONS.max_log_scale_sigma):
            sight = _swept(poi, spec, camera, sweep) or sight
        seen.append(sight)
    return reliable([sight for sight in seen if sight is not None])


def _swept(
    poi: Poi, spec: AnchorSpec, camera: Camera, sweep: Callable[[Array, float], SweptLength | None]
) -> tuple[PoiSight, int] | None:
    """Return a POI by a sweep of its region, with no matches, or None."""
    corners = region_in(poi, spec, camera)
    found = sweep(centroid(corners), float(np.ptp(corners, axis=0).max()))
    return None if found is None else (_sight(poi, spec, camera, found.length, found.log_sigma), 0)


def reliable(sights: list[tuple[PoiSight, int]]) -> list[tuple[PoiSight, int]]:
    """Return the POIs whose own scale is exact enough for a fix, or all POIs where none is.

    So a POI with a few false matches can't contradict another.
    """
    return [sight for sight in sights if sight[0].log_sigma <= OPTIONS.max_log_scale_sigma] or sights


def triangulate_poi(
    poi: Poi, spec: AnchorSpec, camera: Camera, monitor_px: Array, lengths: Array
) -> tuple[PoiSight, int] | None:
    """Return a POI triangulated from matches at pixels (n, 2) with lengths (n,), and the number in its region.

    The length is the weighted median over the region. Matches near the middle have the largest weights, because the
    distance to the middle was measured, and a region often shows more than one surface. None where there are too few.
    """
    corners = region_in(poi, spec, camera)
    middle = centroid(corners)
    chosen = inside_region(monitor_px, corners) & np.isfinite(lengths) & (lengths > 0)
    count = int(chosen.sum())
    if count < OPTIONS.min_region_matches:
        return None
    size = float(np.ptp(corners, axis=0).max())
    distances = np.linalg.norm(monitor_px[chosen] - middle, axis=1)
    weights = 1.0 / (OPTIONS.middle_ratio * size + distances) ** 2
    logs = np.log(lengths[chosen])
    order = np.argsort(logs)
    center = float(logs[order][np.searchsorted(np.cumsum(weights[order]), 0.5 * weights.sum())])
    scatter = float(weights @ np.abs(logs - center) / weights.sum())
    parts = (
        OPTIONS.base_log_sigma,
        OPTIONS.log_sigma_per_scatter * scatter,
        OPTIONS.log_sigma_of_one_match / count,
        OPTIONS.log_sigma_per_size * distances.min() / size,
    )
    log_sigma = float(np.linalg.norm(parts))
    return _sight(poi, spec, camera, float(np.exp(center)), log_sigma), count


def unseen_sights(spec: AnchorSpec, camera: Camera, seen: list[PoiSight]) -> list[PoiSight]:
    """Return the POIs of an anchor that are not among those which a phone sees: of these only the ray is known."""
    known = {sight.on_plan.tobytes() for sight in seen}
    found = [_sight(poi, spec, camera) for poi in spec.pois]
    return [sight for sight in found if sight.on_plan.tobytes() not in known]


def _sight(
    poi: Poi, spec: AnchorSpec, camera: Camera, length: float | None = None, log_sigma: float = 0.0
) -> PoiSight:
    """Return a POI along the ray to its region's middle, at a length where that is known."""
    ray = homogeneous(camera.normalize(centroid(region_in(poi, spec, camera))))[0]
    return PoiSight(
        ray_in_monitor=ray / np.linalg.norm(ray),
        on_plan=np.array([poi.x, poi.y]),
        distance_m=poi.distance_m,
        length=length,
        log_sigma=log_sigma,
        height_offset_m=None if poi.height_m is None else poi.height_m - spec.height_m,
    )
