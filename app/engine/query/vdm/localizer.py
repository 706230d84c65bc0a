"""The Visual-Depth Map paper's localization (B 2.3): a pose per keyframe, lines on the plan, the point nearest to
them; with the checks that every answer of this service passes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtr

from app.engine.maps.open_map import OpenMap
from app.engine.query.camera import scanned_camera
from app.engine.query.localization import KeyframeVote, Localization, same_place
from app.engine.query.placed import Accuracy
from app.engine.query.query import Query
from app.engine.query.vdm.keyframe_fix import KeyframeFix, fix_by_keyframe
from app.engine.query.vdm.keyframe_matches import KeyframeMatches, match_keyframes
from app.engine.query.vdm.user_lines import PlanPosition, user_on_plan
from app.engine.query.verification import (
    Evidence,
    Limits,
    Reason,
    confidence_of,
    gather_evidence,
    judge,
)
from app.engine.stage_timer import StageTimer
from app.geometry.camera import Camera, tangent_of_px
from app.geometry.focal import ApproximateCamera, find_camera
from app.geometry.se3 import Pose
from app.limits import limit
from app.vision.images import Rgb, measure_quality

MEASURED = "roomfix evaluate --pipeline vdm on RedKitchen; docs/visual-depth-map.md."


@dataclass(frozen=True, slots=True, kw_only=True)
class VdmSettings:
    """`best` keyframes give a line each, of those among `candidates` that look most like the query and agree on the
    place. `other_places` and `look_alikes` are matched to learn of rivals."""

    best: int = limit(4, "Keyframes that give a line each.", chosen="Paper B, 2.3: four.")
    candidates: int = limit(12, "Most similar keyframes that are matched.", chosen=MEASURED)
    other_places: int = limit(4, "Further keyframes, each of another place.", chosen=MEASURED)
    look_alikes: int = limit(6, "Look-alikes of each of the best two keyframes.", chosen=MEASURED)
    max_error_tangent: float = limit(
        tangent_of_px(6.0), "Inlier threshold: the reprojection error over the focal length.", chosen=MEASURED
    )


@dataclass(frozen=True, slots=True)
class _Place:
    """Keyframes whose poses for the user agree, the one with most inliers first."""

    fixes: tuple[KeyframeFix, ...]

    @property
    def rows(self) -> NDArray[np.intp]:
        """The query's features that agree, each once."""
        return np.unique(np.concatenate([fix.inliers.query_rows for fix in self.fixes]))


class VdmLocalizer:
    """Localizes frames in one map as paper B does. Stateless between calls, safe to share between threads."""

    def __init__(
        self, opened: OpenMap, settings: VdmSettings | None = None, limits: Limits | None = None
    ) -> None:
        self.map = opened
        self._settings = settings or VdmSettings()
        self._limits = limits or Limits(min_inliers=opened.extractor.min_inliers)

    def localize(
        self,
        rgb: Rgb,
        camera: Camera | ApproximateCamera | None,
        allowed: NDArray[np.int64] | None = None,
        upright: bool = False,
    ) -> Localization:
        """Localize an RGB image (height, width, 3) of a camera of that size; `allowed` restricts retrieval.

        Without a camera, or with an approximate one, the focal length of a centred pinhole is searched for.
        """
        return self.answer(Query.of(rgb, camera, allowed, upright))

    def answer(self, query: Query) -> Localization:
        """Localize a query; turned pictures are not looked for."""
        timer, settings = StageTimer(), self._settings
        rgb, gray, camera, allowed = query.rgb, query.gray, query.known, query.allowed
        descriptor = self.map.descriptor.describe(rgb)
        timer.lap("describe")
        similar = self.map.retrieval.similar(descriptor, settings.candidates, settings.other_places, allowed)
        timer.lap("retrieve")
        matches = match_keyframes(gray, similar, self.map, allowed)
        timer.lap("match")
        if isinstance(camera, Camera):
            camera = scanned_camera(self.map.artifact.metadata, camera)
        else:
            camera = self._find_camera(matches, rgb.shape[:2], camera)
        if camera is None:
            return self._nothing("no_match", matches, None, gray, timer)
        places = self._places(matches, camera)
        timer.lap("pose")
        if not places:
            return self._nothing("no_match", matches, camera, gray, timer)
        known = {found.keyframe for found in matches}
        twins = [twin for twin in self._twins(places[0], allowed) if twin not in known]
        if twins:
            matches += match_keyframes(gray, twins, self.map, allowed)
            timer.lap("match")
            places = self._places(matches, camera)
        return self._conclude(places, camera, timer)

    def _find_camera(
        self, matches: Sequence[KeyframeMatches], size: tuple[int, ...], near: ApproximateCamera | None
    ) -> Camera | None:
        height, width = size
        return find_camera(
            np.concatenate([found.query_px for found in matches]),
            np.concatenate([found.points_in_world for found in matches]),
            width,
            height,
            self._settings.max_error_tangent,
            max(self._limits.min_inliers, 8),
            near,
        )

    def _places(self, matches: Sequence[KeyframeMatches], camera: Camera) -> list[_Place]:
        """Return the places that keyframes put the user at, the one that most of the query's features see first."""
        limit_px = self._settings.max_error_tangent * camera.focal_px
        fixes = [
            fix_by_keyframe(found, self.map.artifact.pose(found.keyframe), camera, limit_px)
            for found in matches
        ]
        left = sorted((fix for fix in fixes if fix is not None), key=lambda fix: -len(fix.inliers))
        places = []
        while left:
            near = [fix for fix in left if same_place(fix.world_from_user, left[0].world_from_user)]
            left = [fix for fix in left if fix not in near]
            places.append(_Place(tuple(near)))
        return sorted(places, key=lambda place: -len(place.rows))

    def _twins(self, place: _Place, allowed: NDArray[np.int64] | None) -> list[int]:
        """Return keyframes of other places that look like the best two."""
        voted = [fix.matches.keyframe for fix in place.fixes[:2]]
        return self.map.retrieval.look_alikes_of(voted, self._settings.look_alikes, allowed)

    def _conclude(self, places: Sequence[_Place], camera: Camera, timer: StageTimer) -> Localization:
        fixes = places[0].fixes[: self._settings.best]
        best = fixes[0]
        rival = places[1].rows if len(places) > 1 else np.zeros(0, np.intp)
        distinct = np.concatenate([fix.inliers.query_rows[fix.inliers.distinct] for fix in fixes])
        evidence = gather_evidence(
            matched_rows=np.concatenate([fix.matches.query_rows for fix in fixes]),
            inlier_rows=np.concatenate([fix.inliers.query_rows for fix in fixes]),
            inlier_px=np.concatenate([fix.inliers.query_px for fix in fixes]),
            distinct_rows=distinct,
            rival_rows=rival,
            size_px=(camera.width, camera.height),
            keyframe_distance_m=self.map.retrieval.distance_m(best.world_from_user),
        )
        votes = tuple(KeyframeVote(f.matches.keyframe, len(f.matches), len(f.inliers)) for f in fixes)
        plan = user_on_plan(fixes)
        own_m, orientation_deg = self._accuracy(plan, best)
        evidence = replace(evidence, position_sigma_m=own_m)
        # What all points share, the map's own error, is not in the covariance.
        position_m = float(np.hypot(own_m, self.map.artifact.metadata.position_sigma_m))
        reason = judge(evidence, position_m, self._limits)
        timer.lap("pose")
        if reason is not None:
            return Localization(
                evidence=evidence,
                reason=reason,
                keyframes=votes,
                camera=camera,
                timings_ms=timer.milliseconds,
            )
        height = best.world_from_user.translation[2]
        pose = Pose(best.world_from_user.rotation, np.array([plan.x, plan.y, height]))
        # What the evidence says, and no more than the error itself allows.
        confidence = min(confidence_of(evidence), _probability_within(0.5, position_m))
        return Localization(
            evidence=evidence,
            world_from_camera=pose,
            accuracy=Accuracy(position_m, orientation_deg),
            confidence=confidence,
            keyframes=votes,
            camera=camera,
            timings_ms=timer.milliseconds,
        )

    def _accuracy(self, plan: PlanPosition, best: KeyframeFix) -> tuple[float, float]:
        own_m = float(np.sqrt(plan.sigma_m**2 + best.covariance[5, 5]))
        turned = np.degrees(np.sqrt(np.trace(best.covariance[:3, :3])))
        return own_m, float(np.hypot(turned, self.map.artifact.metadata.orientation_sigma_deg))

    def _nothing(
        self,
        reason: Reason,
        matches: Sequence[KeyframeMatches],
        camera: Camera | None,
        gray: NDArray[np.uint8],
        timer: StageTimer,
    ) -> Localization:
        timer.lap("pose")
        features = len({int(row) for found in matches for row in found.query_rows})
        if measure_quality(gray).is_poor:
            reason = "poor_image"
        evidence = Evidence(matches=features)
        return Localization(evidence=evidence, reason=reason, camera=camera, timings_ms=timer.milliseconds)


def _probability_within(limit_m: float, position_m: float) -> float:
    """Return how likely an error in space, normal with this root mean square length, is below a limit."""
    return float(chdtr(3, 3.0 * (limit_m / max(position_m, 1e-6)) ** 2))
