"""The monitoring-camera thesis's position of a phone, as its equations stand (C chapter 4).

Where the code departs from the print is listed in app/geometry/README.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.anchors.anchor import AnchorSpec, Poi
from app.engine.anchors.features import NO_WORDS, AnchorDescriber, AnchorFeatures
from app.engine.anchors.matching import PixelMatches, match_akaze
from app.engine.anchors.poi_triangulation import centroid, inside_region, region_in
from app.errors import DegenerateGeometryError
from app.geometry.camera import Camera
from app.geometry.epipolar import estimate_relative_pose_svd
from app.geometry.plan import ground_projection, plan_from_ground_rotation, project_to_ground, start_on_plan
from app.geometry.se3 import Pose
from app.geometry.triangulation import metric_scale, pixel_depths
from app.vision.features import LocalFeatures
from app.vision.images import Rgb, to_gray

Array = NDArray[np.float64]
# The phone's picture is described by A-KAZE alone.
NO_XFEAT = LocalFeatures(np.zeros((0, 2), np.float32), np.zeros((0, 64), np.float32))


@dataclass(frozen=True, slots=True)
class MonitorView:
    """A monitoring camera as the thesis knows it: position, POIs with distances, intrinsics, its frame's features."""

    spec: AnchorSpec
    camera: Camera
    features: AnchorFeatures


@dataclass(frozen=True, slots=True, kw_only=True)
class ThesisFix:
    """A phone's start on the plan and what C eq. 5.1.3 needs to go on from there.

    `on_plan` (2,) is t_OA in metres, `metres_per_unit` r, `plan_from_ground` R_f (2, 2), `ground_from_phone` M_p
    (2, 3). `phone_px` (n, 2) and `points_in_phone` (n, 3) are the triangulated matches, in units of r metres.
    """

    on_plan: Array
    metres_per_unit: float
    plan_from_ground: Array
    ground_from_phone: Array
    phone_px: Array
    points_in_phone: Array
    poi: str
    inliers: int


@dataclass(frozen=True, slots=True)
class _Sights:
    """The matches that agree with the relative pose, and their depths s1 and s2 (n,)."""

    matches: PixelMatches
    monitor_from_phone: Pose
    s1: Array
    s2: Array


def describe_phone(describer: AnchorDescriber, rgb: Rgb) -> AnchorFeatures:
    """Return the A-KAZE features of a phone's picture (C 4.1)."""
    return AnchorFeatures(akaze=describer.akaze.extract(to_gray(rgb)), xfeat=NO_XFEAT, words=NO_WORDS)


def most_similar(
    describer: AnchorDescriber, monitors: Sequence[MonitorView], phone: AnchorFeatures
) -> MonitorView:
    """Return the monitoring camera whose view is most similar by the bag of words (C 4.2.1)."""
    scores = describer.alike_by_words([each.features for each in monitors], phone.akaze)
    return monitors[int(np.argmax(scores))]


def locate_by_thesis(
    monitor: MonitorView, phone: AnchorFeatures, phone_camera: Camera, gravity_in_phone: Array | None
) -> ThesisFix | None:
    """Return the phone's start on the plan beside one monitoring camera, None where an equation has no solution.

    Nothing verifies the answer, as nothing does in the thesis. Without gravity the phone's y axis is vertical.
    """
    sights = _sights(match_akaze(monitor.features, phone), monitor.camera, phone_camera)
    if sights is None:
        return None
    seen = _seen_poi(monitor, sights)
    if seen is None:
        return None
    poi, row = seen
    rays = phone_camera.normalize(sights.matches.phone_px)
    points = sights.s1[:, None] * np.hstack([rays, np.ones((len(rays), 1))])
    monitor_in_phone = sights.monitor_from_phone.inverse().translation
    spec = monitor.spec
    ground_from_phone = ground_projection(gravity_in_phone)
    on_ground = project_to_ground(points[row] - monitor_in_phone, ground_from_phone)
    anchor_on_plan = np.array([spec.x, spec.y])
    try:
        scale = metric_scale(
            poi.distance_m, float(sights.s2[row]), monitor.camera.normalize(sights.matches.monitor_px)[row]
        )
        plan_from_ground = plan_from_ground_rotation(on_ground, np.array([poi.x, poi.y]) - anchor_on_plan)
    except DegenerateGeometryError:
        return None
    start = start_on_plan(anchor_on_plan, monitor_in_phone, scale, plan_from_ground, ground_from_phone)
    usable = (sights.s1 > 0) & (sights.s2 > 0)
    return ThesisFix(
        on_plan=start,
        metres_per_unit=scale,
        plan_from_ground=plan_from_ground,
        ground_from_phone=ground_from_phone,
        phone_px=sights.matches.phone_px[usable],
        points_in_phone=points[usable],
        poi=poi.id,
        inliers=len(sights.matches),
    )


def _sights(matches: PixelMatches, monitor_camera: Camera, phone_camera: Camera) -> _Sights | None:
    """Return R_sm and t_sm by RANSAC and SVD, and the depths of the matches that agree (C eq. 4.2.4-4.2.6)."""
    estimate = estimate_relative_pose_svd(matches.phone_px, matches.monitor_px, phone_camera, monitor_camera)
    if estimate is None:
        return None
    inliers = matches.take(estimate.inlier_mask)
    s1, s2 = pixel_depths(
        phone_camera.normalize(inliers.phone_px),
        monitor_camera.normalize(inliers.monitor_px),
        estimate.b_from_a,
    )
    return _Sights(inliers, estimate.b_from_a, s1, s2)


def _seen_poi(monitor: MonitorView, sights: _Sights) -> tuple[Poi, int] | None:
    """Return the POI with most matches in its region, and the row of the match nearest to the region's middle.

    Depths at or below zero are no sight of it. The thesis measures one POI, at the middle of its region.
    """
    in_front = (sights.s1 > 0) & (sights.s2 > 0)
    best: tuple[int, Poi, int] | None = None
    for poi in monitor.spec.pois:
        corners = region_in(poi, monitor.spec, monitor.camera)
        rows = np.flatnonzero(inside_region(sights.matches.monitor_px, corners) & in_front)
        if len(rows) and (best is None or len(rows) > best[0]):
            away = np.linalg.norm(sights.matches.monitor_px[rows] - centroid(corners), axis=1)
            best = len(rows), poi, int(rows[int(np.argmin(away))])
    return None if best is None else (best[1], best[2])
