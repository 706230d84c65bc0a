"""POIs in a picture: which features lie in a POI's region, and how far away it is by triangulation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.engine.anchors.anchor import AnchorSpec, Poi
from app.geometry.anchor_pose import PoiSight, common_scale
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.geometry.triangulation import homogeneous, pixel_depths

Array = NDArray[np.float64]

# A region needs this many triangulated matches; the scatter of fewer says nothing.
MIN_REGION_MATCHES = 4
# A scale known less well holds no answer.
MAX_LOG_SCALE_SIGMA = 0.25
# A match this share of the region's size from its middle counts half as much as one in the middle, or less.
NEAR_SHARE = 0.05
# One sigma of a length's logarithm, measured: what it is at best, for each unit of scatter, for a single match,
# and when the nearest match is as far from the middle as the region is wide.
BASE_SIGMA, SIGMA_PER_SCATTER, SIGMA_OF_ONE, SIGMA_PER_WIDTH = 0.06, 1.0, 1.0, 0.3


def region_in(poi: Poi, spec: AnchorSpec, camera: Camera) -> Array:
    """Return a POI's corners (n, 2) in pixels of a frame, whose size may differ from the one they were given for."""
    corners = np.array(poi.region_px, dtype=np.float64)
    if not isinstance(spec.camera, Camera):
        return corners
    scale = np.array([camera.width / spec.camera.width, camera.height / spec.camera.height])
    return np.asarray((corners + 0.5) * scale - 0.5)


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
    """Return the centre of area (2,) of a polygon (n, 2), or of its corners when it has no area."""
    following = np.roll(corners, -1, axis=0)
    cross = corners[:, 0] * following[:, 1] - following[:, 0] * corners[:, 1]
    if abs(cross.sum()) < 1e-9:
        return np.asarray(corners.mean(axis=0))
    return np.asarray(((corners + following) * cross[:, None]).sum(axis=0) / (3.0 * cross.sum()))


def lengths_along_rays(normalized: Array, phone_normalized: Array, phone_from_monitor: Pose) -> Array:
    """Return how far along the monitoring camera's rays (n, 2) the matches with a phone's (n, 2) lie, (n,)."""
    depths, _ = pixel_depths(normalized, phone_normalized, phone_from_monitor)
    return np.asarray(depths * np.linalg.norm(homogeneous(normalized), axis=1))


def scale_by_pois(
    spec: AnchorSpec, camera: Camera, monitor_px: Array, lengths_m: Array
) -> tuple[float, float] | None:
    """Return the logarithm by which lengths (n,) of what a monitoring camera sees at pixels (n, 2) are too short, and
    one sigma of it, by the measured distances of its POIs (C eq. 4.2.7); None where no POI is among them."""
    sights = sights_of(spec, camera, monitor_px, lengths_m)
    if not sights:
        return None
    scale, sigma, _ = common_scale([sight for sight, _ in sights])
    return float(np.log(scale)), sigma


def sights_of(
    spec: AnchorSpec, camera: Camera, monitor_px: Array, lengths: Array
) -> list[tuple[PoiSight, int]]:
    """Return those of an anchor's POIs that tell the scale, each as `sight_of` does."""
    seen = (sight_of(poi, spec, camera, monitor_px, lengths) for poi in spec.pois)
    return firm([sight for sight in seen if sight is not None])


def firm(sights: list[tuple[PoiSight, int]]) -> list[tuple[PoiSight, int]]:
    """Return the POIs that tell the scale well enough to do so alone, or all when none does: one with a few stray
    matches says nothing against another."""
    return [sight for sight in sights if sight[0].log_sigma <= MAX_LOG_SCALE_SIGMA] or sights


def sight_of(
    poi: Poi, spec: AnchorSpec, camera: Camera, monitor_px: Array, lengths: Array
) -> tuple[PoiSight, int] | None:
    """Return a POI as triangulated from matches at pixels (n, 2) and lengths (n,), and how many lie in its region.

    The length is the median over the region, where matches near the middle count most: what is measured is the
    distance of the middle, and a region often holds more than one surface. None when it holds too few.
    """
    corners = region_in(poi, spec, camera)
    middle = centroid(corners)
    chosen = inside_region(monitor_px, corners) & np.isfinite(lengths) & (lengths > 0)
    count = int(chosen.sum())
    if count < MIN_REGION_MATCHES:
        return None
    size = float(np.ptp(corners, axis=0).max())
    distances = np.linalg.norm(monitor_px[chosen] - middle, axis=1)
    weights = 1.0 / (NEAR_SHARE * size + distances) ** 2
    logs = np.log(lengths[chosen])
    order = np.argsort(logs)
    center = float(logs[order][np.searchsorted(np.cumsum(weights[order]), 0.5 * weights.sum())])
    scatter = float(weights @ np.abs(logs - center) / weights.sum())
    ray = homogeneous(camera.normalize(middle))[0]
    height_offset = None if poi.height_m is None else poi.height_m - spec.height_m
    parts = (
        BASE_SIGMA,
        SIGMA_PER_SCATTER * scatter,
        SIGMA_OF_ONE / count,
        SIGMA_PER_WIDTH * distances.min() / size,
    )
    log_sigma = float(np.linalg.norm(parts))
    sight = PoiSight(
        ray_in_monitor=ray / np.linalg.norm(ray),
        on_plan=np.array([poi.x, poi.y]),
        distance_m=poi.distance_m,
        length=float(np.exp(center)),
        log_sigma=log_sigma,
        height_offset_m=height_offset,
    )
    return sight, count
