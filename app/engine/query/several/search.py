"""The pose with which most matches of several frames of known motion agree, and the best other place."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from app.engine.maps.open_map import OpenMap
from app.engine.query.hypothesis import seen_from_one_side
from app.engine.query.localization import leading, same_place, votes_of
from app.engine.query.matches import Matches, QueryMatcher
from app.engine.query.placed import Accuracy
from app.engine.query.settings import LocalizerSettings
from app.engine.query.several.hypothesis import RigHypothesis
from app.engine.query.several.options import OPTIONS
from app.geometry.camera import Camera
from app.geometry.estimators.interface import MIN_POINTS
from app.geometry.rigs.pose import estimate_rig_pose
from app.geometry.rigs.refinement import refine_rig_pose, refine_with_uncertain_motion
from app.geometry.rigs.view import RigView
from app.geometry.se3 import Pose, rotation_angle_deg

FrameMatches = Sequence[Matches]


@dataclass(frozen=True, slots=True, kw_only=True)
class RigSearch:
    """Frames with their matchers, cameras and poses in frame 0, and the map that they are searched in."""

    map: OpenMap
    settings: LocalizerSettings
    matchers: tuple[QueryMatcher, ...]
    cameras: tuple[Camera, ...]
    first_from_cameras: tuple[Pose, ...]

    def best(self, starts: Iterable[Pose]) -> RigHypothesis | None:
        """Return the pose that most agrees with, from generalized RANSAC and from poses of frame 0 to start from."""
        matches = tuple(matcher.match_all(()) for matcher in self.matchers)
        found = self._found(matches, self.settings.max_iterations)
        tried = [*starts, *([] if found is None else [found])]
        first = self._most(matches, tried)
        return None if first is None else self._with_covisible(first)

    def rival(self, best: RigHypothesis) -> RigHypothesis | None:
        """Return the best other place that explains matches which the best pose doesn't, on equal terms, as
        `Localizer` looks for one."""
        rest = [
            Matches.merge([own, matcher.match(twins)])
            for own, matcher, twins in zip(best.rest, self.matchers, self._look_alikes(best), strict=True)
        ]
        needed = max(self.settings.min_rival_inliers, self.settings.rival_ratio * best.count)
        if sum(own.feature_count for own in rest) < needed:
            return None
        found = self._found(rest, self.settings.rival_iterations)
        if found is None or same_place(found, best.world_from_first):
            return None
        first = self._at(rest, found)
        if first is None or first.count < needed:
            return None
        rival = self._with_covisible(first)
        return None if rival.is_same_place(best) else rival

    def pose_of(self, hypothesis: RigHypothesis, frame: int) -> Pose:
        """Return the pose of a frame's camera."""
        return hypothesis.world_from_first @ self.first_from_cameras[frame]

    def views(self, matches: FrameMatches) -> list[RigView]:
        """Return the matches of each frame as the rig sees them."""
        return [
            RigView(own.points_px, own.points_in_world, camera, first_from_camera)
            for own, camera, first_from_camera in zip(
                matches, self.cameras, self.first_from_cameras, strict=True
            )
        ]

    def _look_alikes(self, best: RigHypothesis) -> list[list[int]]:
        """Return keyframes of other places that look like the two that most of a frame's inliers are matched with."""
        retrieval, count = self.map.retrieval, self.settings.look_alikes
        found = []
        for own, inliers, matcher in zip(best.matches, best.inliers, self.matchers, strict=True):
            voted = leading(votes_of(own, inliers))
            found.append(
                retrieval.look_alikes_of(voted, count, matcher.query.allowed) if count and voted else []
            )
        return found

    def _with_covisible(self, first: RigHypothesis) -> RigHypothesis:
        """Return the hypothesis again, with the keyframes that must see the same by it."""
        count = self.settings.covisible
        more = [
            matcher.match(
                self.map.retrieval.covisible(
                    self.pose_of(first, frame), count, matcher.matched, matcher.query.allowed
                )
            )
            for frame, matcher in enumerate(self.matchers)
        ]
        matches = [Matches.merge([own, added]) for own, added in zip(first.matches, more, strict=True)]
        return self._by_motion(self._at(matches, first.world_from_first) or first)

    def _by_motion(self, found: RigHypothesis) -> RigHypothesis:
        """Return the hypothesis with a pose that allows for errors of the motion."""
        views = self.views(found.inliers)
        sigmas = [Accuracy(0.0, 0.0), *(motion_sigma(pose) for pose in self.first_from_cameras[1:])]
        pose = refine_with_uncertain_motion(
            views,
            found.world_from_first,
            [(each.position_m, np.radians(each.orientation_deg)) for each in sigmas],
        )
        allowed = self._agreeing(found.matches, pose)
        return allowed if sum(len(own) for own in allowed.inliers) >= MIN_POINTS else found

    def _found(self, matches: FrameMatches, iterations: int) -> Pose | None:
        return estimate_rig_pose(self.views(matches), self.settings.max_error_tangent, iterations)

    def _most(self, matches: FrameMatches, poses: Iterable[Pose]) -> RigHypothesis | None:
        found = [self._at(matches, pose) for pose in poses]
        return max((each for each in found if each is not None), key=_count, default=None)

    def _at(self, matches: FrameMatches, pose: Pose) -> RigHypothesis | None:
        """Return the hypothesis near a pose of frame 0: refined on the matches that agree with it."""
        rough = self._agreeing(matches, pose)
        if sum(len(own) for own in rough.inliers) < MIN_POINTS:
            return None
        refined = refine_rig_pose(self.views(rough.inliers), pose)
        fine = self._agreeing(matches, refined)
        best = rough if rough.count > fine.count else fine
        return best if sum(len(own) for own in best.inliers) >= MIN_POINTS else None

    def _agreeing(self, matches: FrameMatches, pose: Pose) -> RigHypothesis:
        """Return the hypothesis of a pose; a point counts only when seen from its keyframe's side."""
        masks = []
        for own, view in zip(matches, self.views(matches), strict=True):
            limit_px = self.settings.max_error_tangent * view.camera.focal_px
            centres = self.map.artifact.arrays.positions[own.keyframes]
            centre = (pose @ view.rig_from_camera).translation
            front = seen_from_one_side(own.points_in_world, centres, centre)
            masks.append(np.asarray((view.errors_px(pose) <= limit_px) & front))
        return RigHypothesis.of(pose, matches, masks)


def _count(hypothesis: RigHypothesis) -> int:
    return hypothesis.count


def motion_sigma(first_from_camera: Pose) -> Accuracy:
    """Return how accurate the motion of a frame after the first is."""
    length_m = float(np.linalg.norm(first_from_camera.translation))
    turned_deg = OPTIONS.turn_sigma_ratio * rotation_angle_deg(first_from_camera.rotation)
    return Accuracy(OPTIONS.motion_sigma_ratio * length_m, math.hypot(OPTIONS.motion_sigma_deg, turned_deg))
