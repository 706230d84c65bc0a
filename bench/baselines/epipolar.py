"""The Visual-Depth Map paper's baseline: epipolar geometry alone, without any depth."""

from __future__ import annotations

from dataclasses import dataclass

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
from app.geometry.epipolar import RelativePoseEstimate, estimate_relative_pose
from app.geometry.lines import line_through, point_nearest_to_lines
from app.geometry.se3 import Pose
from app.vision.images import Rgb, to_gray

BEST = 4
CANDIDATES = 12
MAX_ERROR_PX = 1.5
# Below this angle between the rays the direction of the move between two cameras is noise.
MIN_PARALLAX_DEG = 0.5


@dataclass(frozen=True, slots=True)
class _Direction:
    """A keyframe's view of the query: their relative pose, up to scale, and the user's direction on the plan."""

    matches: KeyframeMatches
    estimate: RelativePoseEstimate
    line: NDArray[np.float64]
    world_from_user_rotation: NDArray[np.float64]


class EpipolarLocalizer:
    """A baseline to compare with, not a service: like the paper's it has no limits by which it would abstain.

    The essential matrix with each of the best keyframes gives a direction to the user, but no distance; the user
    is the point nearest to the lines along them (B section 3, after eq. 15), as high as the keyframes are.
    """

    def __init__(self, opened: OpenMap) -> None:
        self.map = opened

    def localize(
        self, rgb: Rgb, camera: Camera | None, allowed: NDArray[np.int64] | None = None
    ) -> Localization:
        """Localize an RGB image (height, width, 3) of a known camera; without one there is no answer."""
        timer = StageTimer()
        descriptor = self.map.descriptor.describe(rgb)
        timer.lap("describe")
        similar = self.map.retrieval.similar(descriptor, CANDIDATES, 0, allowed)
        timer.lap("retrieve")
        matches = match_keyframes(to_gray(rgb), similar, self.map)[:BEST]
        timer.lap("match")
        if camera is None:
            return _nothing("no_match", timer, None)
        camera = scanned_camera(self.map.artifact.metadata, camera)
        directions = [d for found in matches if (d := self._direction(found, camera)) is not None]
        try:
            x, y = point_nearest_to_lines(np.stack([d.line for d in directions]).reshape(-1, 3))
        except (DegenerateGeometryError, ValueError):
            timer.lap("pose")
            return _nothing("too_few_inliers", timer, camera)
        return self._conclude(directions, float(x), float(y), camera, timer)

    def _direction(self, found: KeyframeMatches, camera: Camera) -> _Direction | None:
        estimate = estimate_relative_pose(
            found.keyframe_px,
            found.query_px,
            self.map.artifact.camera(found.keyframe),
            camera,
            max_error_px=MAX_ERROR_PX,
        )
        if estimate is None or estimate.parallax_deg < MIN_PARALLAX_DEG:
            return None
        world_from_keyframe = self.map.artifact.pose(found.keyframe)
        world_from_user = world_from_keyframe @ estimate.b_from_a.inverse()
        try:
            line = line_through(world_from_keyframe.translation[:2], world_from_user.translation[:2])
        except DegenerateGeometryError:
            return None
        return _Direction(found, estimate, line, world_from_user.rotation)

    def _conclude(
        self, directions: list[_Direction], x: float, y: float, camera: Camera, timer: StageTimer
    ) -> Localization:
        heights = [self.map.artifact.arrays.positions[d.matches.keyframe, 2] for d in directions]
        best = max(directions, key=lambda d: int(d.estimate.inlier_mask.sum()))
        pose = Pose(best.world_from_user_rotation, np.array([x, y, float(np.mean(heights))]))
        inliers = [d.matches.take(d.estimate.inlier_mask) for d in directions]
        evidence = gather_evidence(
            matched_rows=np.concatenate([d.matches.query_rows for d in directions]),
            inlier_rows=np.concatenate([own.query_rows for own in inliers]),
            inlier_px=np.concatenate([own.query_px for own in inliers]),
            distinct_rows=np.zeros(0, np.intp),
            rival_rows=np.zeros(0, np.intp),
            size_px=(camera.width, camera.height),
            keyframe_distance_m=self.map.retrieval.distance_m(pose),
        )
        votes = tuple(
            KeyframeVote(own.keyframe, len(d.matches), len(own))
            for d, own in zip(directions, inliers, strict=True)
        )
        timer.lap("pose")
        # What it isn't sure of it doesn't know: lines without depth say nothing about their own error.
        return Localization(
            evidence=evidence,
            world_from_camera=pose,
            keyframes=votes,
            camera=camera,
            timings_ms=timer.milliseconds,
        )


def _nothing(reason: Reason, timer: StageTimer, camera: Camera | None) -> Localization:
    return Localization(reason=reason, camera=camera, timings_ms=timer.milliseconds)
