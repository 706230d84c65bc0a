"""How well anchors locate phones anywhere around: cameras as an operator hangs them, by POIs alone and by walls too."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.anchors.anchor import AnchorSpec
from app.engine.anchors.features import AnchorDescriber, AnchorFeatures
from app.engine.anchors.fix import AnchorFix
from app.engine.anchors.locator import roll_deg
from app.engine.anchors.match_anchor import match_anchor
from app.engine.anchors.poi_triangulation import regions_in
from app.engine.anchors.verification import judge_fix
from app.engine.floors.collection import read_collection
from app.engine.floors.walls import FloorWalls
from app.engine.stage_timer import StageTimer
from app.geometry.camera import Camera
from app.geometry.se3 import Pose, rotation_from_vector
from app.vision.images import Rgb, to_gray
from bench.recordings.monitors import MONITOR_CAMERA
from bench.render.frames import Progress
from bench.render.noise import seeded
from bench.render.raycast import FAST, render
from bench.render.scene import Scene
from bench.render.sensor import ColourSensor, colour_picture
from bench.simulation.cameras import HungCamera, hang_cameras, spec_of
from bench.simulation.world import GRAVITY_SIGMA_RAD, DemoBuilding, phone_camera
from bench.venue.plan_image import plan_from_world
from bench.venue.venue import floor_plans

Array = NDArray[np.float64]

PICTURE_WIDTH_PX = 400
NEAREST_M = 0.5
FARTHEST_M = 9.0
HEIGHT_M = 1.5
# Standard deviation of a phone's height in the hands of people of different size.
HEIGHT_SIGMA_M = 0.12
PITCH_DEG = -3.0
PITCH_SIGMA_DEG = 4.0
# Least share of the things in the camera's picture that a phone sees too.
LEAST_COMMON = 0.1
MOST_TRIES = 3000
# A thing is seen when the picture has it at its distance to within this.
SAME_DEPTH_M = 0.1
EVERY_PX = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class HungPair:
    """A camera with its features and walls, and what a phone there sees: its features, gravity in its axes (3,), and
    where it is on the plan; `baseline_m` is its distance from the camera."""

    spec: AnchorSpec
    monitor: AnchorFeatures
    walls: FloorWalls | None
    phone: AnchorFeatures
    phone_camera: Camera
    gravity_in_phone: Array
    plan_from_phone: Pose
    baseline_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class HungOutcome:
    """A phone's outcome: why it is not located, None where it is; the error on the plan and the stated sigma, metres;
    the error of the scale's logarithm and its stated sigma; whether a POI gave the scale."""

    reason: str | None
    error_m: float = 0.0
    sigma_m: float = 0.0
    scale_error: float = 0.0
    scale_sigma: float = 0.0
    has_poi: bool = False


def locate_pair(pair: HungPair, *, with_walls: bool) -> HungOutcome:
    """Return the outcome of a phone beside a camera."""
    fix, _ = match_anchor(
        pair.spec,
        (pair.monitor, MONITOR_CAMERA),
        (pair.phone, pair.phone_camera),
        pair.gravity_in_phone,
        None,
        StageTimer(),
        pair.walls if with_walls else None,
    )
    return HungOutcome(reason="no_match") if fix is None else _outcome(fix, pair)


def _outcome(fix: AnchorFix, pair: HungPair) -> HungOutcome:
    solution = fix.solution
    found, at = solution.plan_from_phone.translation, pair.plan_from_phone.translation
    baseline_m = float(np.linalg.norm(found - solution.plan_from_monitor.translation))
    return HungOutcome(
        reason=judge_fix(fix),
        error_m=float(np.linalg.norm((found - at)[:2])),
        sigma_m=fix.position_sigma_m,
        scale_error=float(np.log(baseline_m / pair.baseline_m)),
        scale_sigma=solution.log_scale_sigma,
        has_poi=len(solution.scale_errors) > 0,
    )


def hung_pairs(
    scene: Scene, most_pois: int, phones: int, seed: int, progress: Progress
) -> Iterator[HungPair]:
    """Yield the pairs of each camera of the building with up to so many phones that see a part of what it sees."""
    describer, building = AnchorDescriber(), DemoBuilding()
    walls = {
        floor.id: FloorWalls.of(read_collection(floor.features, floor.id)[1], lambda points: points)
        for floor in floor_plans()
    }
    cameras = hang_cameras(scene, most_pois)
    for done, camera in enumerate(cameras):
        progress(done, len(cameras))
        rng = seeded("hung", camera.name, seed)
        spec = spec_of(camera)
        rgb, depth_m = render(scene, MONITOR_CAMERA, camera.world_from_camera)
        sensor = ColourSensor(read_noise=2.0, shot_noise=0.2, vignetting=0.15)
        picture = colour_picture(rng, rgb, MONITOR_CAMERA, sensor)
        monitor = describer.describe(picture, MONITOR_CAMERA, regions_in(spec, MONITOR_CAMERA))
        seen = _things(camera, depth_m)
        for pose, shown in _phones(scene, building, camera, seen, phones, rng):
            gravity = pose.rotation.T @ np.array([0.0, 0.0, -1.0])
            gravity = rotation_from_vector(rng.normal(0.0, GRAVITY_SIGMA_RAD, 3)) @ gravity
            gray = to_gray(shown)
            akaze = describer.akaze.extract(gray)
            yield HungPair(
                spec=spec,
                monitor=monitor,
                walls=walls[spec.floor_id],
                phone=describer.describe_phone(gray, akaze, roll_deg(gravity.tolist())),
                phone_camera=phone_camera(PICTURE_WIDTH_PX),
                gravity_in_phone=gravity,
                plan_from_phone=plan_from_world(camera.floor) @ pose,
                baseline_m=float(np.linalg.norm(pose.translation - camera.world_from_camera.translation)),
            )


def _things(camera: HungCamera, depth_m: NDArray[np.float32]) -> Array:
    """Return points (n, 3) in the world that a camera sees."""
    rows, columns = np.mgrid[
        EVERY_PX // 2 : depth_m.shape[0] : EVERY_PX, EVERY_PX // 2 : depth_m.shape[1] : EVERY_PX
    ]
    depths = depth_m[rows.ravel(), columns.ravel()].astype(np.float64)
    pixels = np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float64)
    known = depths > 0
    return camera.world_from_camera.apply(MONITOR_CAMERA.unproject(pixels[known], depths[known]))


def _phones(
    scene: Scene,
    building: DemoBuilding,
    camera: HungCamera,
    seen: Array,
    count: int,
    rng: np.random.Generator,
) -> Iterator[tuple[Pose, Rgb]]:
    """Yield the poses of phones around a camera, drawn at random, that see a part of what it sees, and pictures."""
    lens = phone_camera(PICTURE_WIDTH_PX)
    found = 0
    for _ in range(MOST_TRIES):
        if found == count:
            return
        pose = _drawn(building, camera, rng)
        if pose is None or _in_view(seen, pose, lens).mean() < LEAST_COMMON:
            continue
        rgb, depth_m = render(scene, lens, pose, FAST)
        if _share_seen(seen, pose, lens, depth_m) < LEAST_COMMON:
            continue
        found += 1
        sensor = ColourSensor(
            read_noise=1.6, shot_noise=0.18, vignetting=0.1, exposure=float(rng.uniform(0.85, 1.1))
        )
        yield pose, colour_picture(rng, rgb, lens, sensor)


def _drawn(building: DemoBuilding, camera: HungCamera, rng: np.random.Generator) -> Pose | None:
    """Return a phone's pose around a camera, facing anywhere; None where nobody can stand."""
    away_m, side, yaw = (
        rng.uniform(NEAREST_M, FARTHEST_M),
        rng.uniform(0, 2 * np.pi),
        rng.uniform(0, 2 * np.pi),
    )
    pitch = np.radians(rng.normal(PITCH_DEG, PITCH_SIGMA_DEG))
    height_m = rng.normal(HEIGHT_M, HEIGHT_SIGMA_M)
    x, y = camera.world_from_camera.translation[:2] + away_m * np.array([np.cos(side), np.sin(side)])
    if not building.is_free(x, y, camera.floor):
        return None
    ahead = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    axes = np.column_stack([right, np.cross(ahead, right), ahead])
    return Pose(axes, np.array([x, y, building.ground_m(x, y, camera.floor) + height_m]))


def _in_view(seen: Array, pose: Pose, lens: Camera) -> NDArray[np.bool_]:
    """Return which points (n, 3) project into a phone's picture."""
    in_phone = pose.inverse().apply(seen)
    pixels = lens.project(in_phone)
    inside = (pixels > 0).all(axis=1) & (pixels < [lens.width - 1, lens.height - 1]).all(axis=1)
    return np.asarray(inside & (in_phone[:, 2] > 0))


def _share_seen(seen: Array, pose: Pose, lens: Camera, depth_m: NDArray[np.float32]) -> float:
    """Return the share of points (n, 3) that nothing hides from a phone."""
    inside = _in_view(seen, pose, lens)
    in_phone = pose.inverse().apply(seen[inside])
    pixels = lens.project(in_phone).astype(int)
    hidden = np.abs(depth_m[pixels[:, 1], pixels[:, 0]] - in_phone[:, 2]) > SAME_DEPTH_M
    return float(np.count_nonzero(~hidden)) / len(seen)
