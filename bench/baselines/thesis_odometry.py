"""The thesis's tracking: EPnP on triangulated points from frame to frame, in the axes of the first (C 5.1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.engine.anchors.features import AnchorFeatures
from app.errors import DegenerateGeometryError
from app.geometry.camera import Camera
from app.geometry.plan import odometry_on_plan
from app.geometry.pnp import estimate_pose_epnp_lm
from app.geometry.se3 import Pose
from app.geometry.triangulation import triangulate
from app.vision.features import Descriptors, LocalFeatures
from app.vision.matching import match_unit_vectors, to_unit_vectors
from bench.baselines.thesis_anchor import ThesisFix

Array = NDArray[np.float64]


# Largest ratio of the distances of the two nearest descriptors.
MAX_RATIO = 0.85
# Largest reprojection error of an inlier.
MAX_ERROR_PX = 3.0
# Fewest inliers of a frame that is tracked, and fewest points that are added at once.
MIN_INLIERS = 15
# Least angle between the rays of a new point: its depth is known to some percent.
MIN_PARALLAX_DEG = 1.0
# Newest points that are kept.
MAX_POINTS = 4000


class ThesisOdometry:
    """Tracks a phone from its start on the plan. Points X_i are kept in the axes of the first frame, in units of r."""

    def __init__(self, fix: ThesisFix, features: AnchorFeatures, camera: Camera) -> None:
        self._fix, self._camera = fix, camera
        rows = _rows_of(features.akaze, fix.phone_px)
        self._points = fix.points_in_phone[rows >= 0]
        self._descriptors: Descriptors = np.asarray(
            features.akaze.descriptors[rows[rows >= 0]], dtype=np.uint8
        )
        self._last = features.akaze, Pose.identity()

    def track(self, features: AnchorFeatures) -> tuple[Array, Pose] | None:
        """Return t_OAk (2,) in metres and `first_from_k` with metres (C eq. 5.1.1-5.1.3), None for a lost frame."""
        akaze = features.akaze
        seen, known = _match(akaze.descriptors, self._descriptors)
        pixels, points = akaze.keypoints_px[seen].astype(np.float64), self._points[known]
        found = estimate_pose_epnp_lm(pixels, points, self._camera, max_error_px=MAX_ERROR_PX)
        if found is None or np.count_nonzero(found.inlier_mask) < MIN_INLIERS:
            return None
        first_from_k = found.world_from_camera
        self._add_points(akaze, first_from_k, seen)
        fix = self._fix
        on_plan = odometry_on_plan(
            fix.on_plan,
            first_from_k.translation,
            fix.metres_per_unit,
            fix.plan_from_ground,
            fix.ground_from_phone,
        )
        return on_plan, Pose(first_from_k.rotation, fix.metres_per_unit * first_from_k.translation)

    def _add_points(self, akaze: LocalFeatures, first_from_k: Pose, seen: NDArray[np.intp]) -> None:
        """Triangulate what this frame and the last one of enough distance share and no point explains."""
        before, first_from_before = self._last
        mine, theirs = _match(akaze.descriptors, before.descriptors)
        new = ~np.isin(mine, seen)
        mine, theirs = mine[new], theirs[new]
        before_from_k = first_from_before.inverse() @ first_from_k
        try:
            in_before = triangulate(
                before.keypoints_px[theirs],
                akaze.keypoints_px[mine],
                self._camera,
                self._camera,
                before_from_k.inverse(),
                min_parallax_deg=MIN_PARALLAX_DEG,
            )
        except DegenerateGeometryError:
            return
        known = np.isfinite(in_before).all(axis=1)
        if np.count_nonzero(known) < MIN_INLIERS:
            return
        points = first_from_before.apply(in_before[known])
        self._points = np.concatenate([self._points, points])[-MAX_POINTS:]
        added = np.asarray(akaze.descriptors[mine[known]], dtype=np.uint8)
        self._descriptors = np.concatenate([self._descriptors, added])[-MAX_POINTS:]
        self._last = akaze, first_from_k


def _match(ours: Descriptors, theirs: Descriptors) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    if len(ours) == 0 or len(theirs) < 2:
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    a, b, _ = match_unit_vectors(to_unit_vectors(ours, True), to_unit_vectors(theirs, True), MAX_RATIO, True)
    return a, b


def _rows_of(features: LocalFeatures, pixels: Array) -> NDArray[np.intp]:
    """Return the row (n,) of the feature at each pixel (n, 2), -1 where there is none."""
    rows = {tuple(point): row for row, point in enumerate(features.keypoints_px.astype(np.float64).tolist())}
    return np.array([rows.get(tuple(pixel), -1) for pixel in pixels.tolist()], dtype=np.intp)
