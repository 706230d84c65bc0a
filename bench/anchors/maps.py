"""Self-calibration in a map, and phones in a corner that was taken out of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.anchors.calibration import calibrate_in_map, calibration_of
from app.engine.anchors.features import AnchorFeatures
from app.engine.anchors.fix import MountedCamera
from app.engine.anchors.live_anchor import mounted_camera
from app.engine.anchors.map_depth import SeenPoints
from app.engine.anchors.match_anchor import match_anchor
from app.engine.anchors.verification import judge_fix
from app.engine.floors.floor import Floor
from app.engine.maps.artifact import MapArtifact
from app.engine.maps.open_map import OpenMap
from app.engine.query.localizer import Localizer
from app.engine.stage_timer import StageTimer
from app.errors import ConflictError
from app.geometry.se3 import Pose
from bench.anchors.pairs import AnchorPair, PairEvaluator
from bench.evaluation.pose_errors import pose_error

Array = NDArray[np.float64]

# Radius around a POI in which the map's points count as its corner.
CORNER_M = 2.0
# Keyframes with a larger share of their points in the corner are taken out of the map.
CORNER_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class MapPair:
    """A pair in a mapped venue, with the true pose of its monitoring camera and the POI in the world (3,)."""

    pair: AnchorPair
    world_from_monitor: Pose
    poi_in_world: Array


@dataclass(frozen=True, slots=True)
class CornerOutcome:
    """What became of a pair: the camera's calibration with the whole map (errors in metres and degrees, infinite if
    none, and then why), then with the corner taken out whether the map alone still locates the phone, and the anchor's
    error, infinite when it has no answer."""

    calibration_m: float
    calibration_deg: float
    map_alone: bool
    anchor_error_m: float
    refused: str | None = None


def evaluate_in_map(
    evaluator: PairEvaluator, opened: OpenMap, floors: Mapping[str, Floor], pairs: Sequence[MapPair]
) -> list[CornerOutcome]:
    """Calibrate each pair's camera, take the POI's corner out of the map, and locate the phone without it."""
    return [_outcome(evaluator, opened, floors[one.pair.spec.floor_id], one) for one in pairs]


def _outcome(evaluator: PairEvaluator, opened: OpenMap, floor: Floor, one: MapPair) -> CornerOutcome:
    pair, camera = one.pair, one.pair.monitor_camera
    left = keyframes_outside(opened.artifact, one.poi_in_world)
    alone = Localizer(opened).localize(pair.phone(), pair.phone_camera, left).world_from_camera is not None
    try:
        stored = calibrate_in_map(opened, 0, floor, pair.spec, camera, pair.monitor())
    except ConflictError as error:
        return CornerOutcome(float("inf"), 180.0, alone, float("inf"), str(error))
    calibration, mounted = calibration_of(stored), mounted_camera(stored, floor)
    assert calibration is not None and mounted is not None  # noqa: S101, PT018 - it was just made, on this floor
    assert calibration.points is not None  # noqa: S101
    calibration_m, calibration_deg = pose_error(calibration.world_from_camera, one.world_from_monitor)
    seen = _without_corner(SeenPoints.unpack(calibration.points, camera), one, calibration.world_from_camera)
    error_m = _anchor_error_m(evaluator, pair, mounted, seen)
    return CornerOutcome(calibration_m, calibration_deg, alone, error_m)


def summarize_corners(outcomes: Sequence[CornerOutcome]) -> dict[str, float | int | None]:
    """Return the figures of outcomes: counts, medians in centimetres and degrees, errors of anchors in metres."""
    found = [one for one in outcomes if np.isfinite(one.calibration_m)]
    errors = [one.anchor_error_m for one in outcomes if np.isfinite(one.anchor_error_m)]
    near = [one for one in found if one.calibration_m < 0.05 and one.calibration_deg < 0.5]
    alone = [one for one in outcomes if np.isfinite(one.anchor_error_m) and not one.map_alone]
    return {
        "cameras": len(outcomes),
        "calibrated": len(found),
        "calibrated within 5 cm and 0.5 deg": len(near),
        "calibration, worst cm": _worst([100 * one.calibration_m for one in found]),
        "calibration, worst deg": _worst([one.calibration_deg for one in found]),
        "calibration, median cm": _median([100 * one.calibration_m for one in found]),
        "calibration, median deg": _median([one.calibration_deg for one in found]),
        "corner removed: located by the map alone": sum(one.map_alone for one in outcomes),
        "corner removed: located by the anchor": len(errors),
        "corner removed: by the anchor only": len(alone),
        "corner removed: anchor, median m": _median(errors),
        "corner removed: anchor, worst m": _worst(errors),
    }


def _median(values: Sequence[float]) -> float | None:
    return round(float(np.median(values)), 3) if values else None


def _worst(values: Sequence[float]) -> float | None:
    return round(max(values), 3) if values else None


def keyframes_outside(artifact: MapArtifact, corner: Array) -> NDArray[np.int64]:
    """Return the keyframes of a map that show little of what is around a corner (3,)."""
    distances = np.linalg.norm(artifact.arrays.points_in_world - corner.astype(np.float32), axis=1)
    shares = [
        float(np.mean(distances[artifact.rows(row)] < CORNER_M)) if artifact.rows(row).stop else 0.0
        for row in range(artifact.keyframe_count)
    ]
    return np.flatnonzero(np.array(shares) <= CORNER_SHARE).astype(np.int64)


def _without_corner(seen: SeenPoints, one: MapPair, world_from_monitor: Pose) -> SeenPoints:
    """Return the map's points in the camera's picture but for those around the POI."""
    camera = one.pair.monitor_camera
    rays = camera.unproject(seen.pixels, np.ones(len(seen.pixels)))
    in_camera = seen.lengths_m[:, None] * rays / np.linalg.norm(rays, axis=1, keepdims=True)
    far = np.linalg.norm(world_from_monitor.apply(in_camera) - one.poi_in_world, axis=1) > CORNER_M
    return SeenPoints(seen.pixels[far], seen.lengths_m[far])


def _anchor_error_m(
    evaluator: PairEvaluator, pair: AnchorPair, mounted: MountedCamera, seen: SeenPoints
) -> float:
    plain, camera = evaluator.monitor_features(pair), pair.monitor_camera
    monitor = AnchorFeatures(
        akaze=plain.akaze,
        xfeat=plain.xfeat,
        words=plain.words,
        akaze_length_m=seen.lengths_at(plain.akaze.keypoints_px.astype(np.float64), camera).astype(
            np.float32
        ),
        xfeat_length_m=seen.lengths_at(plain.xfeat.keypoints_px.astype(np.float64), camera).astype(
            np.float32
        ),
    )
    phone = evaluator.phone_features(pair.phone(), pair.gravity_in_phone)
    fix, _ = match_anchor(
        pair.spec,
        (monitor, camera),
        (phone, pair.phone_camera),
        pair.gravity_in_phone,
        mounted,
        StageTimer(),
    )
    if fix is None or judge_fix(fix) is not None:
        return float("inf")
    return float(np.linalg.norm(fix.solution.plan_from_phone.translation[:2] - pair.phone_on_plan))
