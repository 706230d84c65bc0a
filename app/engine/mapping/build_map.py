"""From a scan to a map: keyframes, features, refined points, global descriptors (A 2.1)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.calibrate import calibrate
from app.engine.mapping.calibration_curves import Calibration
from app.engine.mapping.frame_images import frame_rgb
from app.engine.mapping.keyframe_quality import blur_limit, fault_of, find_replacements
from app.engine.mapping.keyframe_rule import KeyframeRule
from app.engine.mapping.options import BuildOptions
from app.engine.mapping.refine_scan import RefinedScan, refined_scan
from app.engine.mapping.second_features import PlacedKeyframe, has_second_features, second_features
from app.engine.mapping.select_keyframes import select_keyframes
from app.engine.mapping.sparse_map import feature_limit, thin_out
from app.engine.mapping.triangulated_depth import with_triangulated_depth
from app.engine.maps.artifact import MapArrays, MapArtifact, MapMetadata
from app.engine.maps.points import MapPoints, View, points_from_depth
from app.engine.maps.repetition import Unplaced, elsewhere
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import Progress, map_in_order
from app.engine.stage_timer import StageTimer
from app.errors import InvalidScanError
from app.geometry.alignment import world_from_scan_by_gravity
from app.geometry.camera import Camera
from app.geometry.depth import sample_depth
from app.geometry.se3 import Pose
from app.geometry.triangulation import homogeneous
from app.importers.frames import Frame, FrameSource
from app.limits import limit
from app.vision.features import LocalFeatureExtractor, LocalFeatures
from app.vision.images import ImageQuality, measure_quality, to_gray
from app.vision.index import GlobalIndex
from app.vision.keyframes import PoseThresholds, select_by_pose
from app.vision.repetition import RunChunks


@dataclass(frozen=True, slots=True, kw_only=True)
class SupportOptions:
    """Supporting frames: those that are no keyframes, but refine points and add features to keyframes."""

    spacing_ratio: float = limit(
        0.45,
        "Thresholds by which supporting frames are selected, divided by those of the pose rule for keyframes.",
        chosen="By hand; no measurement is recorded.",
    )


OPTIONS = SupportOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class BuiltMap:
    """A map that is not yet stored, and the frames it was made of (`keyframes[i]` is keyframe i).

    `discarded` are the names of frames that can't be used, by reason. `replaced` maps the names of discarded keyframes
    to those of the frames that took their places. `seconds` is the time of each stage. `calibration` holds the curves
    that the keyframe thresholds follow from, where the options asked for them.
    """

    artifact: MapArtifact
    index: GlobalIndex
    keyframes: tuple[Frame, ...]
    world_from_scan: Pose
    discarded: dict[str, tuple[str, ...]]
    replaced: dict[str, str] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    calibration: Calibration | None = None


@dataclass(frozen=True, slots=True)
class _Described:
    """What is computed of a frame; not the frame, whose files another worker of the build has elsewhere."""

    view: View
    descriptor: NDArray[np.float32] | None
    quality: ImageQuality


def build_map(
    source: FrameSource,
    options: BuildOptions,
    models: VisionModels,
    executor: Executor,
    progress: Progress,
    world_from_scan: Pose | None = None,
    z_up: bool | None = None,
) -> BuiltMap:
    """Build a map from a scan; raises `InvalidScanError` when nothing in it can become a keyframe.

    `world_from_scan` overrides that of the options (a registration against the present map); `z_up` says whether its
    z axis is known to point up, by default whether the options or the scan state it.
    """
    clock = StageTimer()
    extractor = models.extractor(options.features)
    placed = world_from_scan or scan_placement(options, source)
    poses = [placed @ frame.scan_from_camera for frame in source.frames]
    rule, calibration = options.keyframes, None
    if rule.calibrated:
        calibration = calibrate(source, options, models, executor, progress)
        rule = replace(rule, thresholds=calibration.thresholds)
        clock.lap("calibrate")
    selected = select_keyframes(source, poses, rule, extractor, executor, progress)
    support = supporting_rows(poses, rule, selected) if options.refine_depth or not source.has_depth else []
    clock.lap("select")
    chosen, keyframe_rows = sorted({*selected, *support}), set(selected)

    def describe(row: int, whole: bool = False) -> _Described:
        return _describe(source, row, poses[row], whole or row in keyframe_rows, models, extractor)

    described = dict(zip(chosen, map_in_order(executor, describe, chosen, "describe", progress), strict=True))
    clock.lap("describe")
    usable, left_out, replaced = _usable(
        described, selected, poses, rule, source, partial(describe, whole=True)
    )
    clock.lap("quality")
    refined = _refined(described, usable, source, options, extractor, executor, progress)
    limit = feature_limit(options, extractor, models.global_descriptor.size)
    points = [thin_out(own, refined.camera, limit) for own in refined.points]
    clock.lap("refine")
    z_up = states_up(options, source) if z_up is None else z_up
    run = in_chunks(executor, progress)
    artifact, index, kept = _pack(described, usable, points, refined, z_up, source, options, models, run)
    clock.lap("pack")
    if has_second_features(options) and source.has_depth:
        placed_frames = [PlacedKeyframe(source.frames[row], poses[row]) for row in kept]
        camera = refined.camera
        artifact = _with_second_features(artifact, source, placed_frames, camera, models, executor, progress)
        clock.lap("second features")
    return BuiltMap(
        artifact=artifact,
        index=index,
        keyframes=tuple(source.frames[row] for row in kept),
        world_from_scan=placed,
        discarded={**dict(source.discarded), **left_out},
        replaced=replaced,
        seconds=clock.seconds,
        calibration=calibration,
    )


def _with_second_features(
    artifact: MapArtifact,
    source: FrameSource,
    keyframes: Sequence[PlacedKeyframe],
    camera: Camera,
    models: VisionModels,
    executor: Executor,
    progress: Progress,
) -> MapArtifact:
    second = second_features(source, keyframes, camera, models.extractor("xfeat"), executor, progress)
    return replace(artifact, second=second)


def scan_placement(options: BuildOptions, source: FrameSource) -> Pose:
    """Return `world_from_scan`: that of the options, or one by gravity, or the identity."""
    if options.world_from_scan is not None:
        return options.world_from_scan
    if options.gravity is not None:
        return world_from_scan_by_gravity(options.gravity)
    if source.gravity is not None:
        return world_from_scan_by_gravity(source.gravity)
    return Pose.identity()


def states_up(options: BuildOptions, source: FrameSource) -> bool:
    """Return whether the options or the scan state which way is up, so that z points up in `scan_placement`'s world."""
    stated = options.world_from_scan, options.gravity, source.gravity
    return any(each is not None for each in stated)


def in_chunks(executor: Executor, progress: Progress) -> RunChunks:
    """Return what searches a map for what looks alike in the threads of an executor, and reports how far it is."""
    return lambda search, chunks: map_in_order(executor, search, chunks, "distinguish", progress)


def supporting_rows(poses: Sequence[Pose], rule: KeyframeRule, keyframes: Sequence[int]) -> list[int]:
    """Return the rows of the supporting frames."""
    ratio = OPTIONS.spacing_ratio
    thresholds = PoseThresholds(ratio * rule.thresholds.position_m, ratio * rule.thresholds.attitude_rad)
    return sorted(set(select_by_pose(poses, thresholds)) - set(keyframes))


def _describe(
    source: FrameSource,
    row: int,
    world_from_camera: Pose,
    is_keyframe: bool,
    models: VisionModels,
    extractor: LocalFeatureExtractor,
) -> _Described:
    frame = source.frames[row]
    rgb = frame_rgb(source, frame)
    gray = to_gray(rgb)
    quality = measure_quality(gray)
    features = extractor.extract(gray)
    depth_m = sample_depth(source.depth_m(frame), features.keypoints_px)
    descriptor = models.global_descriptor.describe(rgb) if is_keyframe else None
    view = View(world_from_camera, features, depth_m)
    return _Described(view, descriptor, quality)


def _usable(
    described: dict[int, _Described],
    selected: Sequence[int],
    poses: Sequence[Pose],
    rule: KeyframeRule,
    source: FrameSource,
    describe_keyframe: Callable[[int], _Described],
) -> tuple[list[int], dict[str, tuple[str, ...]], dict[str, str]]:
    """Return the usable keyframes (rows), the names of the unusable ones by reason, and the replacements by name.

    Replacements are added to `described`.
    """
    limit = blur_limit([item.quality for item in described.values()])
    fault = {row: fault_of(described[row].quality, limit) for row in selected}
    usable = [row for row in selected if fault[row] is None]

    def is_good(row: int) -> bool:
        known = described.get(row)
        quality = known.quality if known else measure_quality(to_gray(frame_rgb(source, source.frames[row])))
        return fault_of(quality, limit) is None

    replaced = find_replacements(selected, usable, poses, rule.thresholds, is_good)
    described.update((row, describe_keyframe(row)) for row in replaced.values())
    usable = sorted({*usable, *replaced.values()})
    if not usable:
        raise InvalidScanError("No frame of the scan is sharp and bright enough to become a keyframe.")
    names = [frame.name for frame in source.frames]
    left_out = {
        reason: tuple(names[row] for row in selected if fault[row] == reason)
        for reason in sorted({reason for reason in fault.values() if reason is not None})
    }
    return usable, left_out, {names[old]: names[new] for old, new in replaced.items()}


def _refined(
    described: dict[int, _Described],
    usable: Sequence[int],
    source: FrameSource,
    options: BuildOptions,
    extractor: LocalFeatureExtractor,
    executor: Executor,
    progress: Progress,
) -> RefinedScan:
    """Return the points of the usable keyframes, and the camera, refined where the options ask for it."""
    camera = source.camera
    views = {row: item.view for row, item in described.items()}
    if not source.has_depth:
        views = with_triangulated_depth(views, camera, extractor, executor, progress)
    if options.refine_depth:
        sharp = _sharp(described)
        return refined_scan(
            views, usable, sharp, camera, extractor, executor, progress, has_sensor=source.has_depth
        )
    return RefinedScan([points_from_depth(views[row], camera) for row in usable], camera)


def _sharp(described: dict[int, _Described]) -> list[int]:
    """Return the rows of the frames that are sharp and well exposed."""
    limit = blur_limit([item.quality for item in described.values()])
    return [row for row, item in described.items() if fault_of(item.quality, limit) is None]


def _pack(
    described: dict[int, _Described],
    usable: Sequence[int],
    points: Sequence[MapPoints],
    refined: RefinedScan,
    z_up: bool,
    source: FrameSource,
    options: BuildOptions,
    models: VisionModels,
    run: RunChunks,
) -> tuple[MapArtifact, GlobalIndex, list[int]]:
    extractor = models.extractor(options.features)
    kept = [(row, own) for row, own in zip(usable, points, strict=True) if len(own.features)]
    if not kept:
        raise InvalidScanError(
            "No feature of any keyframe has a valid depth: check depth_scale and that depth fits the colour images, or "
            "for a scan without depth that the camera moved sideways between frames."
        )
    poses = [described[row].view.world_from_camera for row, _ in kept]
    counts = [len(own.features) for _, own in kept]
    features = [own.features for _, own in kept]
    descriptors = _stack_descriptors(features)
    points_in_world = np.concatenate([own.points_in_world for _, own in kept]).astype(np.float32)
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    global_descriptors = np.stack([d for row, _ in kept if (d := described[row].descriptor) is not None])
    # Of a depth scan nearly all features have points; of one without, half have none.
    unplaced = None
    if not source.has_depth:
        views = [described[row].view for row, _ in kept]
        unplaced = _unplaced(views, features, refined.camera, global_descriptors)
    distance, keyframe = elsewhere(
        descriptors, extractor.binary, points_in_world, offsets, poses, z_up, run, unplaced
    )
    arrays = MapArrays(
        positions=np.stack([pose.translation for pose in poses]),
        quaternions=np.stack([pose.quaternion for pose in poses]),
        camera_rows=np.zeros(len(kept), np.int32),
        offsets=offsets,
        keypoints_px=np.concatenate([f.keypoints_px for f in features]).astype(np.float32),
        points_in_world=points_in_world,
        point_sigma_m=np.concatenate([own.sigma_m for _, own in kept]).astype(np.float32),
        distance_elsewhere=distance,
        keyframe_elsewhere=keyframe,
        descriptors=descriptors,
    )
    model = models.global_descriptor
    metadata = MapMetadata(
        features=options.features,
        descriptor_sha256=model.sha256,
        descriptor_size=model.size,
        cameras=(refined.camera,),
        keyframe_names=tuple(source.frames[row].name for row, _ in kept),
        lens_sigmas=(refined.lens_sigma,),
        z_up=z_up,
        has_scale=source.has_scale,
    )
    index = GlobalIndex.from_descriptors(global_descriptors)
    return MapArtifact(metadata=metadata, arrays=arrays), index, [row for row, _ in kept]


def _unplaced(
    views: Sequence[View],
    placed: Sequence[LocalFeatures],
    camera: Camera,
    global_descriptors: NDArray[np.float32],
) -> Unplaced:
    """Return the features of keyframes that are not among those with points."""
    left = []
    for view, own in zip(views, placed, strict=True):
        known = set(map(tuple, own.keypoints_px.tolist()))
        is_known = np.array([tuple(pixel) in known for pixel in view.features.keypoints_px.tolist()], bool)
        left.append(view.features.take(~is_known))
    pixels = np.concatenate([own.keypoints_px for own in left])
    return Unplaced(
        descriptors=np.concatenate([own.descriptors for own in left]),
        keyframes=np.repeat(np.arange(len(views)), [len(own) for own in left]),
        rays_in_camera=homogeneous(camera.normalize(pixels.astype(np.float64))),
        global_descriptors=global_descriptors,
    )


def _stack_descriptors(features: Sequence[LocalFeatures]) -> NDArray[np.uint8] | NDArray[np.float16]:
    stacked = np.concatenate([f.descriptors for f in features])
    # The rounding error of half precision is far below the noise of a learned descriptor.
    return stacked.astype(np.float16) if stacked.dtype == np.float32 else stacked.astype(np.uint8)
