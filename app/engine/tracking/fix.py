"""Fixes: what tells a tracked camera where it is, be it a map or an anchor."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtr

from app.engine.query.accuracy import accuracy_of, sigma_across
from app.engine.query.contradiction import contradicted_in_map
from app.engine.query.localization import KeyframeVote, Localization, same_place
from app.engine.query.localizer import Localizer
from app.engine.query.matches import Matches
from app.engine.query.placed import Accuracy, PlacedPose, Support
from app.engine.query.upright import contradicts_gravity
from app.engine.query.verification import Reason, confidence_of, coverage, evidence_of
from app.engine.tracking.frame import TrackingFrame
from app.engine.tracking.guided_matching import match_near_projections
from app.engine.tracking.hypotheses import poses_of
from app.engine.tracking.odometry.monitor_view import SeenByMonitor
from app.engine.tracking.settings import MapFixOptions
from app.geometry.anchor_pose import Vertical
from app.geometry.camera import Camera
from app.geometry.pnp import estimate_pose_lo_ransac
from app.geometry.se3 import Pose
from app.vision.features import LocalFeatures
from app.vision.matching import to_unit_vectors

Array = NDArray[np.float64]


OPTIONS = MapFixOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class Fix:
    """A pose with its accuracy, and the pixels (n, 2) and points (n, 3) in its frame that odometry goes on from;
    `point_sigma_m` (n,) is the standard deviation of a point across the camera's ray.

    Pixels and `camera` are those of the frame at tracking size. A fix whose scale rests on known distances may have a
    wrong scale: `scale_sigma` is its relative standard deviation, `shared_scale_sigma` the part of it that is the same
    in all fixes that rest on these distances. `anchors` are the monitoring cameras that it comes from, `vertical` what
    they take as vertical, and `seen` where one of them sees the points. `camera_sigma` is what is not known of the
    camera besides, alike in all its pictures (None: not looked at).
    """

    placed: PlacedPose
    accuracy: Accuracy
    support: Support
    confidence: float
    points_px: Array
    points_in_frame: Array
    point_sigma_m: Array
    camera: Camera
    method: str = "rgbd"
    keyframes: tuple[KeyframeVote, ...] = ()
    scale_sigma: float = 0.0
    shared_scale_sigma: float = 0.0
    anchors: tuple[str, ...] = ()
    vertical: Vertical | None = None
    seen: SeenByMonitor | None = None
    camera_sigma: Accuracy | None = None

    @property
    def frame_from_camera(self) -> Pose:
        """The pose in the frame that it is placed in."""
        return self.placed.frame_from_camera

    @property
    def frame_id(self) -> str:
        """The frame that the fix is placed in."""
        return self.placed.frame_id


@dataclass(frozen=True, slots=True)
class NoFix:
    """Why there is none, how many features were matched and agreed, and whether two places were seen."""

    reason: Reason
    support: Support = Support()
    is_contested: bool = False


def _is_far(pose: Pose | None, near: Pose) -> bool:
    """Whether a pose is out of the prior's reach: another place, or another floor."""
    if pose is None:
        return False
    offset = pose.translation - near.translation
    return bool(np.linalg.norm(offset) > OPTIONS.prior_radius_m or abs(offset[2]) > OPTIONS.prior_climb_m)


def _is_upright(pose: Pose) -> bool:
    """Whether a camera was held upright: then it still is, and need not be looked for in other ways."""
    return float(-pose.rotation[2, 1]) > OPTIONS.upright_cosine


class FixSource(Protocol):
    """What gives fixes."""

    def locate(
        self, frame: TrackingFrame, camera: Camera | None, near: Pose | None, any_floor: bool = False, /
    ) -> Fix | NoFix:
        """Return where a frame is, looking everywhere; `near` may decide between places that look alike, but not for
        a camera that may be on `any_floor` by now.

        `camera` is the one of the frame at tracking size; without it the focal length is searched for.
        """

    def refresh(self, frame: TrackingFrame, camera: Camera, predicted: Pose, /) -> Fix | None:
        """Return where a frame is, looking only where points should be by a pose that is nearly right; None when
        they are not there."""

    def nearby(self, frame: TrackingFrame, camera: Camera, near: Pose, reach_m: float, /) -> Fix | None:
        """Return where a frame is, of all places within reach of one where the camera was a moment ago; None when
        none of them is seen, or when two of them look alike."""


class MapFixes:
    """Fixes by a map."""

    def __init__(self, localizer: Localizer) -> None:
        self.localizer = localizer
        self._described: tuple[TrackingFrame, LocalFeatures] | None = None

    def locate(
        self, frame: TrackingFrame, camera: Camera | None, near: Pose | None, any_floor: bool = False
    ) -> Fix | NoFix:
        """Locate by the whole map, as a single photo is (`Localizer.localize`)."""
        full = None if camera is None else camera.scaled_to(frame.rgb.shape[1], frame.rgb.shape[0])
        upright = near is not None and _is_upright(near)
        found = self.localizer.localize(frame.rgb, full, upright=upright)
        if any_floor:
            near = None
        if near is not None and (found.reason == "ambiguous" or _is_far(found.world_from_camera, near)):
            positions = self.localizer.map.artifact.arrays.positions
            close = np.linalg.norm(positions - near.translation, axis=1) < OPTIONS.prior_radius_m
            close &= np.abs(positions[:, 2] - near.translation[2]) < OPTIONS.prior_climb_m
            allowed = np.flatnonzero(close).astype(np.int64)
            nearer = self.localizer.localize(frame.rgb, full, allowed, upright)
            told_apart = None if camera is None else self._by_prior(frame, camera, nearer, near)
            if told_apart is not None:
                return told_apart
            if found.reason == "ambiguous" or nearer.world_from_camera is not None:
                found = nearer
        evidence = found.evidence
        if found.world_from_camera is None or found.camera is None:
            return NoFix(found.reason or "no_match", evidence.support)
        z_up = self.localizer.map.artifact.metadata.z_up
        is_unsure = near is None and found.confidence < OPTIONS.sure_confidence
        if is_unsure or (z_up and contradicts_gravity(found.world_from_camera, frame.gravity)):
            return NoFix("ambiguous", evidence.support)
        assert found.accuracy is not None  # noqa: S101 - located
        tracked = frame.scaled(found.camera)
        matches = self._near(
            self._features(frame), tracked, found.world_from_camera, OPTIONS.found_radius_tangent
        )
        among = found.accuracy_among or found.accuracy
        return Fix(
            placed=PlacedPose(found.world_from_camera),
            accuracy=among,
            camera_sigma=found.accuracy.beyond(among),
            support=evidence.support,
            confidence=found.confidence,
            points_px=matches.points_px,
            points_in_frame=matches.points_in_world,
            point_sigma_m=self._across(matches, found.world_from_camera),
            camera=tracked,
            keyframes=found.keyframes,
        )

    def _by_prior(self, frame: TrackingFrame, camera: Camera, nearer: Localization, near: Pose) -> Fix | None:
        """Return the fix of a pose near the prior that alone is ambiguous: the prior tells it from its look-alikes."""
        pose = nearer.candidate
        if nearer.reason != "ambiguous" or pose is None or _is_far(pose, near):
            return None
        return self._found(self._features(frame), camera, pose, OPTIONS.found_radius_tangent)

    def refresh(self, frame: TrackingFrame, camera: Camera, predicted: Pose) -> Fix | None:
        """Match the map points that keyframes around the predicted pose see, and estimate the pose from them."""
        return self._found(self._features(frame), camera, predicted, OPTIONS.search_radius_tangent)

    def nearby(self, frame: TrackingFrame, camera: Camera, near: Pose, reach_m: float) -> Fix | None:
        """Match all features with keyframes around a place, and go on as `refresh` does with each pose in reach
        that they agree on.

        What looks alike further away can't be meant; what looks alike within reach is told from nothing.
        """
        features = self._features(frame)
        keyframes = self._around(frame, near, reach_m)
        found: list[Fix] = []
        for pose in poses_of(features, self.localizer.map, keyframes, camera):
            if np.linalg.norm(pose.translation - near.translation) > reach_m or _is_far(pose, near):
                continue
            fix = self._found(features, camera, pose, OPTIONS.found_radius_tangent)
            if fix is not None and (reach_m <= OPTIONS.known_reach_m or self._is_sure(fix)):
                found.append(fix)
        best = max(found, key=lambda fix: fix.support.inliers, default=None)
        if best is None:
            return None
        others = [fix for fix in found if not same_place(fix.frame_from_camera, best.frame_from_camera)]
        return (
            None
            if any(fix.support.inliers > OPTIONS.max_rival_share * best.support.inliers for fix in others)
            else best
        )

    def _is_sure(self, fix: Fix) -> bool:
        """Whether so much agrees that it is no part of another place which the map knows better than the true one."""
        enough = fix.support.inliers >= OPTIONS.sure_inlier_factor * self.localizer.map.extractor.min_inliers
        return (
            enough and coverage(fix.points_px, (fix.camera.width, fix.camera.height)) >= OPTIONS.sure_coverage
        )

    def _around(self, frame: TrackingFrame, near: Pose, reach_m: float) -> list[int]:
        """Return keyframes that may see what a camera within reach of a place sees, whichever way it faces."""
        positions = self.localizer.map.artifact.arrays.positions
        offsets = positions - near.translation
        on_floor = np.abs(offsets[:, 2]) < OPTIONS.prior_climb_m
        keyframes = self.localizer.map.retrieval.covisible(
            near, OPTIONS.nearby_keyframes, set(), np.flatnonzero(on_floor)
        )
        if reach_m > OPTIONS.known_reach_m:
            close = on_floor & (np.linalg.norm(offsets, axis=1) < reach_m + OPTIONS.view_reach_m)
            allowed = np.flatnonzero(close).astype(np.int64)
            keyframes += (
                self.localizer.map.similar(frame.rgb, OPTIONS.nearby_keyframes, allowed)
                if len(allowed)
                else []
            )
        return list(dict.fromkeys(keyframes))

    def _features(self, frame: TrackingFrame) -> LocalFeatures:
        """Return the features of a frame, looked for once."""
        if self._described is None or self._described[0] is not frame:
            self._described = frame, self.localizer.map.extractor.extract(frame.gray)
        return self._described[1]

    def _found(self, features: LocalFeatures, camera: Camera, near: Pose, radius: float) -> Fix | None:
        """Return the fix of the map's points around where a pose nearly right has them, None unless the picture
        speaks for it and not against it."""
        fix = self._concluded(self._near(features, camera, near, radius), camera, near)
        return (
            None if fix is None or self._contradicted(features, fix) > OPTIONS.max_contradicted_share else fix
        )

    def _contradicted(self, features: LocalFeatures, fix: Fix) -> float:
        """Return the share of the picture that speaks against a fix."""
        unit = to_unit_vectors(features.descriptors, self.localizer.map.extractor.binary)
        own = features.keypoints_px.astype(np.float64), unit
        return contradicted_in_map(self.localizer.map, fix.frame_from_camera, fix.camera, own, fix.points_px)

    def _concluded(self, matches: Matches, camera: Camera, predicted: Pose) -> Fix | None:
        """Return the fix of matches near a predicted pose, None unless enough of them agree all over the image."""
        estimate = estimate_pose_lo_ransac(
            matches.points_px,
            matches.points_in_world,
            camera,
            max_error_px=OPTIONS.max_error_tangent * camera.focal_px,
            max_iterations=300,
            min_iterations=20,
            prior=predicted,
        )
        if estimate is None:
            return None
        pose, inliers = estimate.world_from_camera, matches.take(estimate.inlier_mask)
        needed = OPTIONS.guided_inlier_factor * self.localizer.map.extractor.min_inliers
        if len(inliers) < needed or len(inliers) < OPTIONS.guided_inlier_ratio * len(matches):
            return None
        if coverage(inliers.points_px, (camera.width, camera.height)) < OPTIONS.guided_coverage:
            return None
        across = self._across(inliers, pose)
        own = accuracy_of(inliers.points_px, inliers.points_in_world, across, camera, pose)
        # The predicted pose tells look-alikes apart: all that was found near it is distinct.
        evidence = evidence_of(matches, inliers, camera, self.localizer.map.retrieval.distance_m(pose))
        evidence = replace(evidence, position_sigma_m=own.position_m)
        return Fix(
            placed=PlacedPose(pose),
            accuracy=own.with_map_error(self.localizer.map.artifact.metadata),
            support=Support(len(inliers), len(matches)),
            confidence=confidence_of(evidence),
            points_px=inliers.points_px,
            points_in_frame=inliers.points_in_world,
            point_sigma_m=across,
            camera=camera,
        )

    def _near(self, features: LocalFeatures, camera: Camera, pose: Pose, radius: float) -> Matches:
        opened = self.localizer.map
        keyframes = opened.retrieval.covisible(pose, OPTIONS.covisible_keyframes, set())
        return match_near_projections(
            features,
            opened.extractor,
            opened.artifact,
            keyframes,
            camera,
            pose,
            radius * camera.focal_px,
        )

    def _across(self, matches: Matches, pose: Pose) -> Array:
        """Return the sigma of points across the camera's ray: a point is uncertain along its keyframe's ray."""
        centres = self.localizer.map.artifact.arrays.positions[matches.keyframes]
        return sigma_across(matches.sigma_m, matches.points_in_world, centres, pose.translation)


def confidence_of_sigma(accuracy: Accuracy) -> float:
    """Return the probability that an error of this accuracy is below 0.5 m and 5 degrees.

    A sigma is that of the error's length: with three equal axes its square is a chi-square of three.
    """
    within_m = chdtr(3, 3.0 * (0.5 / max(accuracy.position_m, 1e-6)) ** 2)
    within_deg = chdtr(3, 3.0 * (5.0 / max(accuracy.orientation_deg, 1e-6)) ** 2)
    return float(within_m * within_deg)
