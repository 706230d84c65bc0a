"""Fixes by anchors: a session starts, and goes on, where no map is, from what a monitoring camera sees (C 4, 5.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from app.engine.anchors.anchor import ANYWHERE, AnchorSearch, AnchorSpec
from app.engine.anchors.fix import AnchorFix
from app.engine.anchors.locator import AnchorLocalization
from app.engine.anchors.place_on_floor import place_on_floor, world_pose
from app.engine.anchors.poi_triangulation import OPTIONS as TRIANGULATION_OPTIONS
from app.engine.anchors.poi_triangulation import scale_by_pois
from app.engine.anchors.verification import confidence_of_fix
from app.engine.floors.floor import Floor
from app.engine.query.placed import WORLD, Accuracy, PlacedPose, Support, plan_frame
from app.engine.tracking.fix import Fix, FixSource, NoFix
from app.engine.tracking.frame import TrackingFrame
from app.engine.tracking.odometry.monitor_view import ScaleOf
from app.engine.tracking.two_view_fix import KnownView, fix_from_two_views
from app.geometry.camera import Camera
from app.geometry.plan import PlanTransform
from app.geometry.se3 import Pose
from app.limits import limit
from app.vision.images import Rgb


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorFixOptions:
    """How well anchors know a scale."""

    map_scale_sigma: float = limit(
        0.03,
        "Relative sigma of a scale that a map gives, the same in all pictures of an anchor.",
        chosen="roomfix track-anchors; docs/anchors.md.",
    )


OPTIONS = AnchorFixOptions()


class LocateByAnchors(Protocol):
    """What a venue's anchors say of an image, its camera and gravity; all of them, or those that a search leaves."""

    def __call__(
        self,
        rgb: Rgb,
        camera: Camera,
        gravity: Sequence[float] | None,
        search: AnchorSearch = ANYWHERE,
        /,
    ) -> AnchorLocalization:
        """Return where the image was taken."""


class AnchorFixes:
    """Fixes by a venue's anchors, on its `floors` as they are now."""

    def __init__(self, locate: LocateByAnchors, floors: Sequence[Floor]) -> None:
        self._locate = locate
        self._floors = floors

    def locate(
        self,
        frame: TrackingFrame,
        camera: Camera | None,
        _near: Pose | None,
        _any_floor: bool = False,
        search: AnchorSearch = ANYWHERE,
    ) -> Fix | NoFix:
        """Locate by the anchors that see what the frame shows, all of them or those that a `search` leaves; without a
        camera there is no fix."""
        if camera is None:
            return NoFix("no_match")
        full = camera.scaled_to(frame.rgb.shape[1], frame.rgb.shape[0])
        found = self._locate(frame.rgb, full, frame.gravity, search)
        if found.best is None or found.floor_id is None or found.plan_from_phone is None:
            return NoFix(found.reason or "no_match", found.support, found.is_contested)
        if place_on_floor(self._floors, found.floor_id, found.plan_from_phone) is None:
            return NoFix("outside_venue", found.support)
        floor = next(floor for floor in self._floors if floor.id == found.floor_id)
        anchor, answer = found.best
        fix = fix_of_anchor(
            answer, anchor.anchor.spec, anchor.camera, frame, camera, floor.id, floor.plan_from_world
        )
        if fix is None:
            return NoFix("too_few_inliers", found.support)
        return replace(fix, anchors=(anchor.anchor.id,))

    def refresh(self, _frame: TrackingFrame, _camera: Camera, _predicted: Pose) -> None:
        """Return that there is none: an anchor has no points to look for."""

    def nearby(self, _frame: TrackingFrame, _camera: Camera, _near: Pose, _reach_m: float) -> None:
        """Return that there is none."""


def fix_of_anchor(
    answer: AnchorFix,
    spec: AnchorSpec,
    monitor_camera: Camera,
    frame: TrackingFrame,
    camera: Camera,
    floor_id: str,
    plan_from_world: NDArray[np.float64] | None = None,
) -> Fix | None:
    """Return an anchor's answer for a frame as what odometry goes on from, in the world if the floor's plan has a place
    there; None when too few of its matches can be placed. `camera` is the frame's at tracking size."""
    solution, inliers = answer.solution, answer.inliers
    frame_from_monitor, frame_from_phone = solution.plan_from_monitor, solution.plan_from_phone
    frame_id, world_per_plan = plan_frame(floor_id), 1.0
    if plan_from_world is not None:
        plan = PlanTransform(plan_from_world)
        world_per_plan = 1.0 / plan.scale
        frame_from_monitor = world_pose(plan, frame_from_monitor)
        frame_from_phone = world_pose(plan, frame_from_phone)
        frame_id = WORLD
    # What the features in a POI's region are nearer or further than its middle is the same in all pictures, too.
    # So is what a room alone is off by.
    shared = solution.log_scale_sigma
    if len(solution.scale_errors):
        shared = TRIANGULATION_OPTIONS.base_log_sigma / float(np.sqrt(len(solution.scale_errors)))
    if solution.length_scatter > 0:
        shared = OPTIONS.map_scale_sigma
    known = KnownView(
        monitor_camera,
        PlacedPose(frame_from_monitor, frame_id),
        max(solution.log_scale_sigma, shared),
        shared,
        None if answer.is_calibrated else _scale_of(spec, monitor_camera, world_per_plan),
    )
    share = frame.size_px[0] / frame.rgb.shape[1]
    fix = fix_from_two_views(
        (inliers.phone_px + 0.5) * share - 0.5,
        inliers.monitor_px,
        camera,
        known,
        frame_from_monitor.inverse() @ frame_from_phone,
    )
    if fix is None:
        return None
    # The two views say nothing of how the monitoring camera lies on the plan.
    return replace(
        fix,
        accuracy=Accuracy(
            max(fix.accuracy.position_m, world_per_plan * answer.position_sigma_m),
            max(fix.accuracy.orientation_deg, answer.orientation_sigma_deg),
        ),
        confidence=confidence_of_fix(answer),
        vertical=solution.vertical,
        support=Support(fix.support.inliers, answer.evidence.matches),
    )


def _scale_of(spec: AnchorSpec, camera: Camera, world_per_plan: float) -> ScaleOf:
    """Return what an anchor's POIs say of the scale of lengths, of which so many are a metre on the plan."""
    return lambda pixels, lengths: scale_by_pois(spec, camera, pixels, lengths / world_per_plan)


class FirstFixes:
    """Fixes by the first of several sources that has one: the map, then the anchors, as `method: auto`."""

    def __init__(self, sources: Sequence[FixSource]) -> None:
        self.sources = tuple(sources)

    def locate(
        self, frame: TrackingFrame, camera: Camera | None, near: Pose | None, any_floor: bool = False
    ) -> Fix | NoFix:
        """Return the first fix; else the first reason that is not the lack of a map."""
        nothing = NoFix("no_map")
        for source in self.sources:
            found = source.locate(frame, camera, near, any_floor)
            if isinstance(found, Fix):
                return found
            if nothing.reason == "no_map":
                nothing = found
        return nothing

    def refresh(self, frame: TrackingFrame, camera: Camera, predicted: Pose) -> Fix | None:
        """Return the first fix near a predicted pose."""
        return next(
            (fix for source in self.sources if (fix := source.refresh(frame, camera, predicted)) is not None),
            None,
        )

    def nearby(self, frame: TrackingFrame, camera: Camera, near: Pose, reach_m: float) -> Fix | None:
        """Return the first fix around a place."""
        return next(
            (
                fix
                for source in self.sources
                if (fix := source.nearby(frame, camera, near, reach_m)) is not None
            ),
            None,
        )
