"""The poses of a scan that has none, estimated from its pictures, with their scale and the direction of down."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from app.engine.mapping.frame_images import frame_rgb
from app.engine.mapping.structure.chosen import ChosenPictures, choose_pictures
from app.engine.mapping.structure.depth.held import STAGE, held_to_depth
from app.engine.mapping.structure.depth.unit import doubts_of_unit
from app.engine.mapping.structure.floor.levels import Floor, find_floor, is_steady
from app.engine.mapping.structure.matches import MatchedPictures, match_pictures
from app.engine.mapping.structure.reconstruction import OPTIONS as RECONSTRUCTION
from app.engine.mapping.structure.reconstruction import (
    Reconstruction,
    check_installed,
    median_angle_deg,
    median_depth,
    reconstruct,
)
from app.engine.mapping.structure.scale import OPTIONS as SCALE
from app.engine.mapping.structure.scale import FoundScale, doubts_of, find_scale
from app.engine.mapping.structure.scale_options import Scale, frames_of
from app.engine.mapping.structure.sequence import Path3D, reconstruct_sequence
from app.engine.mapping.structure.up import DownDirection, down_by_sensor, find_down
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import Progress
from app.errors import InvalidScanError
from app.geometry.se3 import Pose
from app.importers.depth_figures import depth_figures
from app.importers.frames import Scan
from app.importers.unposed.scan import UnposedScan
from app.limits import limit
from app.vision.images import Gray, to_gray


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimateOptions:
    """What becomes of a reconstruction."""

    warned_share: float = limit(
        0.8, "A warning is given where a smaller share of the chosen frames is connected.", chosen="By hand."
    )
    refused_share: float = limit(
        0.5,
        "Where a smaller share is connected and no scale is found, the refusal names where the path broke first.",
        chosen="By hand: what states the scale is then likely in another part.",
    )
    min_joined_share: float = limit(
        0.9,
        "Least share of the chosen frames of a video that a path of several joined parts must hold.",
        chosen="By hand, on four runs of `roomfix evaluate-video`: paths that hold 79 and 86 % were right within 8 cm, "
        "but one of 83 % was bent by 77 cm, as was one of 64 %.",
    )
    min_joined_share_on_floor: float = limit(
        0.8,
        "The same of a path above a level floor, at one height.",
        chosen="By hand, on the ground floor of `roomfix evaluate-video`: 85 % of its pictures, within 10 cm; its "
        "bent forms were off the floor by 5 to 15 % of the camera's height.",
    )
    warned_unsteadiness: float = limit(
        0.05,
        "A warning is given where the camera's height above the floor varies by more on a path of joined parts.",
        chosen="By hand, on the videos of `roomfix evaluate-video`: 0.02 to 0.04 on right paths, 0.06 to 0.08 on bent "
        "ones; a person may also raise the phone by as much.",
    )
    warned_angle_deg: float = limit(
        4.5,
        "A warning is given where the median angle between the rays to a point is smaller, and there is no depth.",
        chosen="By hand: 6.3 to 8.3 on the right paths of `roomfix evaluate-video` and in RedKitchen; 2.9 on one "
        "of desk_rs, before which the camera moves by 25 cm, whose scale drifts by 25 %.",
    )
    cached_pictures: int = limit(
        24, "Pictures that are kept in memory.", chosen="By hand: those of one pixel."
    )


OPTIONS = EstimateOptions()
WITHOUT_SCALE = (
    "The map has no scale: positions are in a unit of its own, and there are no plan positions. Give scale in the "
    "options: a known distance, a printed marker, the camera's height, or three places on the plan."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimatedScan:
    """The scan with estimated poses, what the report says of them, and what to warn of."""

    scan: Scan
    report: dict[str, Any]
    warnings: tuple[str, ...]


def estimate_poses(
    unposed: UnposedScan, scale: Scale | None, models: VisionModels, executor: Executor, progress: Progress
) -> EstimatedScan:
    """Return the scan of the pictures that could be connected.

    Frames that could not be are discarded as `unconnected`. Its scale is that of the options, else of its depth images;
    without either it has none. Raises `InvalidScanError` where too few pictures are usable or overlap, where the scale
    can't be found, before all where the depth images' unit is neither stated nor possible, and where pycolmap is not
    installed.
    """
    check_installed()
    chosen = choose_pictures(unposed, frames_of(scale), RECONSTRUCTION.min_frames, progress)
    scan = chosen.scan
    measured = depth_figures(scan) if scale is None else None
    doubts = () if measured is None else doubts_of_unit(measured, scan.depth)
    matched = match_pictures(chosen, models, executor, progress)

    @lru_cache(maxsize=OPTIONS.cached_pictures)
    def gray(row: int) -> Gray:
        return to_gray(frame_rgb(scan, scan.frames[row]))

    held = {frame.name: frame.down for frame in unposed.recorded if frame.down is not None}
    downs = {row: held[frame.name] for row, frame in enumerate(scan.frames) if frame.name in held}

    def down_of(part: Reconstruction) -> DownDirection | None:
        return down_by_sensor(part, downs) or find_down(part, gray, executor, progress)

    path = _path(chosen, matched, down_of, unposed.scratch, progress)
    parts = path.parts
    if not parts:
        raise InvalidScanError(
            f"The {len(scan.frames)} pictures that were chosen overlap too little to be connected: film more slowly, "
            "with the camera moving sideways and not only turning, past things with texture."
        )
    whole = _held_to_depth(parts[0], chosen, matched, progress)
    path = replace(path, parts=[whole, *parts[1:]])
    down = down_of(whole)
    floor = None if down is None else find_floor(whole, down.down)
    check_joined(path, _times_s(chosen), floor)
    try:
        found = find_scale(scale, whole, chosen, down, gray, executor, progress)
    except InvalidScanError as error:
        if not chosen.is_sequence or len(whole.poses) >= OPTIONS.refused_share * len(scan.frames):
            raise
        raise InvalidScanError(f"{path.where_it_broke(_times_s(chosen))} In the largest: {error}") from error
    held_at = doubts_of(found, floor, median_depth(whole))
    posed = _posed(chosen, whole, down, found)
    return EstimatedScan(
        scan=posed,
        report=_report(chosen, path, down, floor, found),
        warnings=(*doubts, *_warnings(chosen, path, floor, found), *held_at),
    )


def check_joined(path: Path3D, times_s: Sequence[float], floor: Floor | None) -> None:
    """Raise `InvalidScanError` where a path was joined of parts and much of it is still missing.

    What loses its way so often shows too little to join the rest without bending it, and a bent map agrees with itself.
    Where the camera stays at one height above a level floor, less of it is enough.
    """
    held = len(path.parts[0].poses) / len(times_s)
    least = OPTIONS.min_joined_share_on_floor if is_steady(floor) else OPTIONS.min_joined_share
    if path.joined > 1 and held < least:
        raise InvalidScanError(
            f"{path.where_it_broke(times_s)} With {held:.0%} of them in {path.joined} joined parts the path may be "
            "bent: film the building in pieces, each a map of its own, or with a phone that records depth or poses."
        )


def _held_to_depth(
    part: Reconstruction, chosen: ChosenPictures, matched: MatchedPictures, progress: Progress
) -> Reconstruction:
    if not chosen.scan.has_depth:
        return part
    return held_to_depth(
        part,
        [features.keypoints_px for features in matched.features],
        chosen.depth_of,
        chosen.scan.camera,
        is_calibrated=chosen.camera_source == "given",
        report=lambda: progress.report(STAGE, len(part.poses), len(part.poses)),
    )


def _path(
    chosen: ChosenPictures,
    matched: MatchedPictures,
    down_of: Callable[[Reconstruction], DownDirection | None],
    scratch: Path | None,
    progress: Progress,
) -> Path3D:
    camera, is_calibrated = chosen.scan.camera, chosen.camera_source == "given"
    if chosen.is_sequence:
        return reconstruct_sequence(
            matched,
            camera,
            _times_s(chosen),
            down_of,
            is_calibrated=is_calibrated,
            scratch=scratch,
            progress=progress,
        )
    parts = reconstruct(matched, camera, is_calibrated=is_calibrated, scratch=scratch, progress=progress)
    return Path3D(parts, None)


def _times_s(chosen: ChosenPictures) -> list[float]:
    """Return the times of the pictures since the first one."""
    times_s = [frame.timestamp_s for frame in chosen.scan.frames]
    return [time_s - times_s[0] for time_s in times_s]


def _posed(
    chosen: ChosenPictures, part: Reconstruction, down: DownDirection | None, scale: FoundScale | None
) -> Scan:
    scan = chosen.scan
    units = scale.metres_per_unit if scale is not None else SCALE.own_depth / median_depth(part)
    turn = scale.plan_from_scan if scale is not None else None
    gravity = None if down is None else down.down
    if turn is not None:
        # The frame of the plan stands upright.
        gravity = (0.0, 0.0, -1.0)
    frames = tuple(
        replace(scan.frames[row], scan_from_camera=_scaled(pose, units, turn))
        for row, pose in part.poses.items()
    )
    lost = tuple(frame for row, frame in enumerate(scan.frames) if row not in part.poses)
    discarded = dict(scan.discarded)
    if lost:
        discarded["unconnected"] = tuple(frame.name for frame in lost)
    return replace(
        scan,
        camera=part.camera,
        frames=frames,
        discarded=discarded,
        left_out=(*scan.left_out, *lost),
        gravity=gravity,
        has_scale=scale is not None,
    )


def _scaled(pose: Pose, units: float, turn: Pose | None) -> Pose:
    scaled = Pose(pose.rotation, units * pose.translation)
    return scaled if turn is None else turn @ scaled


def _report(
    chosen: ChosenPictures,
    path: Path3D,
    down: DownDirection | None,
    floor: Floor | None,
    scale: FoundScale | None,
) -> dict[str, Any]:
    whole, *rest = path.parts
    names = [frame.name for frame in chosen.scan.frames]
    others = [
        {"frames": len(part.poses), "first": names[min(part.poses)], "last": names[max(part.poses)]}
        for part in rest
        if not set(part.poses) <= set(whole.poses)
    ]
    return {
        "pictures": chosen.total,
        "chosen": len(names),
        "connected": len(whole.poses),
        "joined_parts": path.joined,
        "other_parts": others,
        "revisits": None if path.revisits is None else path.revisits.as_dict(),
        "points": len(whole.points),
        "error_px": round(whole.error_px, 3),
        "angle_deg": round(median_angle_deg(whole), 1),
        "camera": {
            "source": {"guess": "self_calibrated", "exif": "exif_calibrated"}.get(
                chosen.camera_source, chosen.camera_source
            ),
            "model": whole.camera.model,
            "params": [round(value, 4) for value in whole.camera.params],
        },
        "scale": {"source": "none"} if scale is None else scale.as_dict(),
        "up": {"source": "none"} if down is None else down.as_dict(),
        "floor": None if floor is None else _floor_report(floor, scale),
    }


def _floor_report(floor: Floor, scale: FoundScale | None) -> dict[str, Any]:
    metres = None if scale is None else round(floor.height * scale.metres_per_unit, 2)
    return {
        "points": len(floor.points),
        "camera_height_m": metres,
        "camera_height_varies_by": round(floor.unsteadiness, 3),
    }


def _warnings(
    chosen: ChosenPictures, path: Path3D, floor: Floor | None, scale: FoundScale | None
) -> tuple[str, ...]:
    warnings = [] if scale is not None else [WITHOUT_SCALE]
    if path.joined > 1 and not chosen.scan.has_depth:
        warnings.extend(_bends(path.joined, floor))
    angle_deg = median_angle_deg(path.parts[0])
    if angle_deg < OPTIONS.warned_angle_deg and not chosen.scan.has_depth:
        warnings.append(
            f"The rays to half of the points are less than {angle_deg:.1f} degrees apart: the camera hardly moved for "
            "what it saw, so that sizes may drift by a tenth and more. Walk while filming, or send depth images too."
        )
    total, connected = len(chosen.scan.frames), len(path.parts[0].poses)
    if connected < OPTIONS.warned_share * total:
        warnings.append(
            f"Only {connected} of {total} chosen pictures are connected with each other; the others are not in "
            "the map (unconnected in discarded_frames)."
        )
        if chosen.is_sequence:
            warnings.append(path.where_it_broke(_times_s(chosen)))
    return tuple(warnings)


def _bends(joined: int, floor: Floor | None) -> list[str]:
    """Return what is said of a path of so many joined parts that its floor doesn't show to be straight."""
    compare = "compare distances at both ends with the building."
    if floor is None:
        return [
            f"The path was joined of {joined} parts, and too little of the floor is in view to hold it straight: it "
            f"may be bent. Film the floor too, or {compare}"
        ]
    if floor.unsteadiness > OPTIONS.warned_unsteadiness:
        return [
            f"The camera's height above the floor varies by {floor.unsteadiness:.0%} along the path. Where it was held "
            f"at one height above a level floor, the map is bent: {compare}"
        ]
    return []
