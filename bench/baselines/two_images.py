"""The RGB-D paper's reference method: two retrieved colour images with known poses, and no depth (A 3.2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.open_map import OpenMap
from app.engine.query.camera import scanned_camera
from app.engine.query.localization import KeyframeVote, Localization
from app.engine.query.vdm.keyframe_matches import KeyframeMatches, match_keyframes
from app.engine.query.verification import Reason, gather_evidence
from app.engine.stage_timer import StageTimer
from app.errors import DegenerateGeometryError
from app.geometry.camera import Camera
from app.geometry.pnp import estimate_pose_epnp_lm
from app.geometry.triangulation import triangulate
from app.vision.images import Rgb, to_gray

RETRIEVED = 2
MAX_ERROR_PX = 6.0
Array = NDArray[np.float64]


class TwoImageLocalizer:
    """A baseline to compare with: the two most similar keyframes, their poses, and the features that both share with
    the query, triangulated from the two keyframes; then EPnP and Levenberg-Marquardt. Depth is not used, and nothing
    makes sure that the two keyframes see the features at a sufficient angle."""

    def __init__(self, opened: OpenMap) -> None:
        self.map = opened

    def localize(
        self, rgb: Rgb, camera: Camera | None, allowed: NDArray[np.int64] | None = None
    ) -> Localization:
        """Localize an RGB image (height, width, 3) of a known camera; without one there is no answer."""
        timer = StageTimer()
        descriptor = self.map.descriptor.describe(rgb)
        timer.lap("describe")
        similar = self.map.retrieval.similar(descriptor, RETRIEVED, 0, allowed)[:RETRIEVED]
        timer.lap("retrieve")
        matches = match_keyframes(to_gray(rgb), similar, self.map)
        timer.lap("match")
        if camera is None or len(matches) < RETRIEVED:
            return _nothing("no_match", timer, camera)
        return self._conclude(matches, scanned_camera(self.map.artifact.metadata, camera), timer)

    def _conclude(self, matches: list[KeyframeMatches], camera: Camera, timer: StageTimer) -> Localization:
        first, second = matches
        rows, in_first, in_second = np.intersect1d(first.query_rows, second.query_rows, return_indices=True)
        points = self._triangulated(first, second, in_first, in_second)
        known = np.isfinite(points).all(axis=1)
        pixels = first.query_px[in_first][known]
        found = estimate_pose_epnp_lm(pixels, points[known], camera, max_error_px=MAX_ERROR_PX)
        timer.lap("pose")
        if found is None:
            return _nothing("too_few_inliers", timer, camera)
        evidence = gather_evidence(
            matched_rows=rows[known],
            inlier_rows=rows[known][found.inlier_mask],
            inlier_px=pixels[found.inlier_mask],
            distinct_rows=np.zeros(0, np.intp),
            rival_rows=np.zeros(0, np.intp),
            size_px=(camera.width, camera.height),
            keyframe_distance_m=self.map.retrieval.distance_m(found.world_from_camera),
        )
        return Localization(
            evidence=evidence,
            world_from_camera=found.world_from_camera,
            keyframes=tuple(
                KeyframeVote(own.keyframe, len(own), int(found.inlier_mask.sum())) for own in matches
            ),
            camera=camera,
            timings_ms=timer.milliseconds,
        )

    def _triangulated(
        self,
        first: KeyframeMatches,
        second: KeyframeMatches,
        in_first: NDArray[np.intp],
        in_second: NDArray[np.intp],
    ) -> Array:
        """Return the world points (n, 3) of features that both keyframes share; NaN where the rays are parallel."""
        artifact = self.map.artifact
        world_from_first = artifact.pose(first.keyframe)
        second_from_first = artifact.pose(second.keyframe).inverse() @ world_from_first
        try:
            points_in_first = triangulate(
                first.keyframe_px[in_first],
                second.keyframe_px[in_second],
                artifact.camera(first.keyframe),
                artifact.camera(second.keyframe),
                second_from_first,
            )
        except DegenerateGeometryError:
            return np.full((len(in_first), 3), np.nan)
        return world_from_first.apply(points_in_first)


def _nothing(reason: Reason, timer: StageTimer, camera: Camera | None) -> Localization:
    return Localization(reason=reason, camera=camera, timings_ms=timer.milliseconds)
