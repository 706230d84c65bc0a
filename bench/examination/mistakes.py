"""Everyday mistakes made on a right scan, and right scans that look poor: what the examination says of each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from app.engine.mapping.examination.outcome import Examination, RefusedScanError
from app.engine.mapping.examination.sparseness import is_sparse
from app.engine.mapping.options import parse_build_options
from app.engine.progress import Progress
from app.engine.stage_timer import StageTimer
from app.errors import InvalidScanError
from app.geometry.se3 import rotation_from_vector
from app.geometry.turns import camera_from_turned, turned_camera
from app.importers.conventions import PoseArrays, PoseConvention
from app.importers.registry import open_scan
from app.services.examine_scan import ExaminedScan, examined_scan
from bench.examination.scan_copy import RawDepth, ScanCopy

LATE_S = 0.2
# Rows of a trajectory this near to each other meet any time within the importer's tolerance.
DENSE_S = 0.04
CLOCK_RATIO = 1.02
FOCAL_RATIO = 1.12
# A bracket that was taken for straight, about an axis of no special direction.
MOUNT_DEG = (3.0, -3.2, 2.4)
DEPTH_SHIFT_PX = 24
DISPARITY_SCALE = 2000.0
# A picture of 16:9 that was squeezed to 4:3.
STRETCH_RATIO = 4 / 3
# Where another session's frame lies in the first one's.
SESSION_TURN_DEG = (0.0, 5.0, 0.0)
SESSION_STEP_M = (0.3, 0.1, -0.1)
# Depth loses this part of its height and width on each side.
CUT_PARTS = 16
FEET_PER_M = 3.28084
NOISE_RATIO = 0.015
LOST_SHARE = 0.05
# What may be warned of instead of refused: poses and depth are right, and the map locates.
WARNED_OF = frozenset({"gravity_direction"})


@dataclass(frozen=True, slots=True)
class Mistake:
    """A mistake, the codes of findings that name it, and how it changes a right scan."""

    name: str
    codes: tuple[str, ...]
    make: Callable[[ScanCopy], ScanCopy]


@dataclass(frozen=True, slots=True, kw_only=True)
class Examined:
    """What came of one scan: the verdict, the codes of its findings, what was said, and the seconds it took.

    `usable` is the scan as it may be built, repaired where it had to be; None where nothing was beyond doubt.
    """

    name: str
    verdict: str
    codes: tuple[str, ...]
    sentence: str
    seconds: float
    named: bool
    usable: ExaminedScan | None = None


def _written(**convention: Any) -> Callable[[ScanCopy], ScanCopy]:
    def make(copy: ScanCopy) -> ScanCopy:
        return replace(copy, poses=PoseConvention(**convention).written(copy.poses))

    return make


def _portrait(copy: ScanCopy) -> ScanCopy:
    return replace(
        copy,
        picture=lambda rgb: np.ascontiguousarray(np.rot90(rgb, 3)),
        depth=lambda raw: np.ascontiguousarray(np.rot90(raw, 3)),
        camera=turned_camera(copy.camera, 3),
    )


def _depth_scale(copy: ScanCopy) -> ScanCopy:
    read_at = 5000.0 if copy.depth_scale < 3000 else 1000.0
    return replace(copy, options={"depth_scale": read_at})


def _late(seconds: float) -> Callable[[ScanCopy], ScanCopy]:
    def make(copy: ScanCopy) -> ScanCopy:
        spacing_s = float(np.median(np.diff(copy.times_s)))
        # Rows as far apart as frames must still meet them: late by whole rows.
        late_s = seconds if spacing_s < DENSE_S else spacing_s * max(1, round(seconds / spacing_s))
        return replace(copy, times_s=copy.times_s + late_s)

    return make


def _fast_clock(copy: ScanCopy) -> ScanCopy:
    first_s = copy.scan.frames[0].timestamp_s
    return replace(copy, times_s=first_s + CLOCK_RATIO * (copy.times_s - first_s))


def _one_frame_late(copy: ScanCopy) -> ScanCopy:
    each = copy.with_row_per_frame()
    before = np.maximum(np.arange(len(each.times_s)) - 1, 0)
    return replace(each, poses=PoseArrays(each.poses.rotations[before], each.poses.positions[before]))


def _focal(copy: ScanCopy) -> ScanCopy:
    fx, fy, *rest = copy.camera.params
    return replace(copy, camera=replace(copy.camera, params=(fx * FOCAL_RATIO, fy * FOCAL_RATIO, *rest)))


def _mounted(copy: ScanCopy) -> ScanCopy:
    turned = copy.poses.rotations @ rotation_from_vector(np.radians(MOUNT_DEG)).T
    return replace(copy, poses=PoseArrays(turned, copy.poses.positions))


def _swapped_point(copy: ScanCopy) -> ScanCopy:
    fx, fy, cx, cy, *rest = copy.camera.params
    return replace(copy, camera=replace(copy.camera, params=(fx, fy, cy, cx, *rest)))


def _gravity_up(copy: ScanCopy) -> ScanCopy:
    if copy.gravity is None:
        raise InvalidScanError("The mistake of gravity that points up needs a scan whose gravity is known.")
    x, y, z = copy.gravity
    return replace(copy, gravity=(-x, -y, -z))


def _gravity_aside(copy: ScanCopy) -> ScanCopy:
    if copy.gravity is None:
        raise InvalidScanError(
            "The mistake of gravity that points aside needs a scan whose gravity is known."
        )
    x, y, z = copy.gravity
    # The axes of the scan's frame are taken for one another.
    return replace(copy, gravity=(y, z, x))


def _shifted_depth(raw: RawDepth) -> RawDepth:
    moved = np.zeros_like(raw)
    moved[:, DEPTH_SHIFT_PX:] = raw[:, :-DEPTH_SHIFT_PX]
    return moved


def _depth_of_frame_before(copy: ScanCopy) -> ScanCopy:
    frames = copy.scan.frames
    late = tuple(
        replace(frame, depth=before.depth)
        for frame, before in zip(frames, (frames[0], *frames[:-1]), strict=True)
    )
    return replace(copy, scan=replace(copy.scan, frames=late))


def _depth_turned(*steps: int) -> Callable[[ScanCopy], ScanCopy]:
    def make(copy: ScanCopy) -> ScanCopy:
        return replace(copy, depth=lambda raw: np.ascontiguousarray(raw[:: steps[0], :: steps[1]]))

    return make


def _disparity(copy: ScanCopy) -> ScanCopy:
    def change(raw: RawDepth) -> RawDepth:
        known = (raw > 0) & (raw < 65535)
        inverse = DISPARITY_SCALE * copy.depth_scale / np.maximum(raw, 1)
        return np.where(known, np.minimum(np.rint(inverse), 65534), 0).astype(np.uint16)

    return replace(copy, depth=change)


def _one_focal_length(copy: ScanCopy) -> ScanCopy:
    fx, *rest = copy.camera.params
    return replace(copy, camera=replace(copy.camera, params=(fx * STRETCH_RATIO, *rest)))


def _mirrored(copy: ScanCopy) -> ScanCopy:
    return replace(
        copy,
        picture=lambda rgb: np.ascontiguousarray(rgb[:, ::-1]),
        depth=lambda raw: np.ascontiguousarray(raw[:, ::-1]),
    )


def _standing_still(copy: ScanCopy) -> ScanCopy:
    first = np.zeros(len(copy.times_s), dtype=np.intp)
    return replace(copy, poses=PoseArrays(copy.poses.rotations[first], copy.poses.positions[first]))


def _sorted_as_text(copy: ScanCopy) -> ScanCopy:
    each = copy.with_row_per_frame()
    order = np.array(sorted(range(len(each.times_s)), key=str))
    return replace(each, poses=PoseArrays(each.poses.rotations[order], each.poses.positions[order]))


def _along_rays(copy: ScanCopy) -> ScanCopy:
    v, u = np.mgrid[: copy.camera.height, : copy.camera.width]
    plane = copy.camera.normalize(np.stack([u, v], axis=-1).reshape(-1, 2))
    lengths = np.sqrt(1.0 + (plane**2).sum(axis=1)).reshape(u.shape)
    return replace(copy, depth=lambda raw: np.minimum(np.rint(raw * lengths), 65534).astype(np.uint16))


def _of_two_sessions(copy: ScanCopy) -> ScanCopy:
    later = copy.times_s > copy.scan.frames[2 * len(copy.scan.frames) // 3].timestamp_s
    turned = rotation_from_vector(np.radians(SESSION_TURN_DEG))
    rotations, positions = copy.poses.rotations.copy(), copy.poses.positions.copy()
    rotations[later] = turned @ rotations[later]
    positions[later] = positions[later] @ turned.T + np.array(SESSION_STEP_M)
    return replace(copy, poses=PoseArrays(rotations, positions))


def _half_in_millimetres(copy: ScanCopy) -> ScanCopy:
    later = copy.times_s > copy.scan.frames[len(copy.scan.frames) // 2].timestamp_s
    factors = np.where(later, 1000.0, 1.0)[:, None]
    return replace(copy, poses=PoseArrays(copy.poses.rotations, copy.poses.positions * factors))


def _cut_depth(raw: RawDepth) -> RawDepth:
    height, width = raw.shape
    rows, columns = height // CUT_PARTS, width // CUT_PARTS
    kept = raw[rows : height - rows, columns : width - columns]
    return np.asarray(cv2.resize(kept, (width, height), interpolation=cv2.INTER_NEAREST), dtype=np.uint16)


MISTAKES = (
    Mistake("axes of OpenGL", ("camera_axes",), _written(axes="rub")),
    Mistake("axes of a ROS body", ("camera_axes",), _written(axes="flu")),
    Mistake("axes of Unity", ("camera_axes",), _written(axes="ruf")),
    Mistake("camera_from_world", ("inverted_poses",), _written(poses="camera_from_world")),
    Mistake("quaternions w x y z", ("quaternion_order",), _written(quaternion="wxyz")),
    Mistake("pictures turned", ("turned_pictures",), _portrait),
    Mistake("depth scale", ("depth_scale",), _depth_scale),
    Mistake("positions in millimetres", ("position_scale",), _written(position_scale=1000.0)),
    Mistake("positions in feet", ("position_scale",), _written(position_scale=FEET_PER_M)),
    Mistake("poses 0.2 s late", ("time_offset",), _late(LATE_S)),
    Mistake("poses by a clock 2 % fast", ("time_offset",), _fast_clock),
    Mistake("poses one frame late", ("time_offset",), _one_frame_late),
    Mistake("focal length 12 % off", ("focal_length",), _focal),
    Mistake("camera mounted 5 degrees off", ("camera_mount",), _mounted),
    Mistake("cx and cy exchanged", ("turned_intrinsics", "principal_point"), _swapped_point),
    Mistake("gravity points up", ("gravity_up",), _gravity_up),
    Mistake("gravity points aside", ("gravity_direction",), _gravity_aside),
    Mistake(
        "depth bytes exchanged", ("depth_byte_order",), lambda c: replace(c, depth=lambda raw: raw.byteswap())
    ),
    Mistake("depth 24 px aside", ("depth_shift",), lambda c: replace(c, depth=_shifted_depth)),
    Mistake("pictures mirrored", ("mirrored_pictures",), _mirrored),
    Mistake("poses stand still", ("poses_stand_still",), _standing_still),
    Mistake("poses sorted as text", ("pose_order",), _sorted_as_text),
    Mistake("depth along the rays", ("depth_along_rays",), _along_rays),
    Mistake("fx a third too long", ("focal_length",), _one_focal_length),
    Mistake("depth of the frame before", ("depth_of_other_frames",), _depth_of_frame_before),
    Mistake("poses of two sessions", ("poses_jump",), _of_two_sessions),
    Mistake("half of the positions in millimetres", ("mixed_scale", "poses_jump"), _half_in_millimetres),
    Mistake("depth cut and enlarged", ("depth_field",), lambda c: replace(c, depth=_cut_depth)),
    Mistake("depth alone mirrored", ("depth_turned",), _depth_turned(1, -1)),
    Mistake("depth alone upside down", ("depth_turned",), _depth_turned(-1, -1)),
    Mistake("disparity for depth", ("depth_is_disparity",), _disparity),
)


def right_variants(whole: ScanCopy) -> list[tuple[str, ScanCopy]]:
    """Return right scans that look poorer: thinned, with noise in depth, of half the resolution."""
    rng = np.random.default_rng(0)

    def noisy(raw: RawDepth) -> RawDepth:
        noise = 1.0 + NOISE_RATIO * rng.standard_normal(raw.shape)
        kept = rng.random(raw.shape) > LOST_SHARE
        return np.where(kept & (raw < 65535), np.minimum(np.rint(raw * noise), 65534), 0).astype(np.uint16)

    width, height = whole.camera.width // 2, whole.camera.height // 2
    half = replace(
        whole,
        picture=lambda rgb: np.asarray(
            cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8
        ),
        depth=lambda raw: np.ascontiguousarray(raw[::2, ::2]),
        camera=whole.camera.scaled_to(width, height),
    )
    return [
        ("as it is", whole),
        ("every third frame", _thinned(whole, 3)),
        ("every fifth frame", _thinned(whole, 5)),
        ("noise in depth", replace(whole, depth=noisy)),
        ("half resolution", half),
        ("pictures on their side", _on_its_side(whole)),
    ]


def _on_its_side(copy: ScanCopy) -> ScanCopy:
    """Return what a phone saves that was held upright and takes its pictures along its longer side."""
    turned = _portrait(copy)
    rotations = copy.poses.rotations @ camera_from_turned(3).rotation
    return replace(turned, poses=PoseArrays(rotations, copy.poses.positions))


def _thinned(copy: ScanCopy, step: int) -> ScanCopy:
    return replace(copy, scan=replace(copy.scan, frames=copy.scan.frames[::step]))


def examine_copy(
    name: str, copy: ScanCopy, codes: Sequence[str], folder: Path, executor: Executor, progress: Progress
) -> Examined:
    """Write a copy into a folder, examine it as a build would, and again with `repair` when it is refused.

    `codes` are the findings that name what is wrong with it; with none of them it is a right scan.
    """
    options = copy.write(folder)
    clock = StageTimer()
    found = _examine(folder, options, executor, progress)
    clock.lap("examine")
    examination = found.examination
    if examination is None:
        raise InvalidScanError("A copy with a stated motion is not examined.")
    found_codes = tuple(finding.code for finding in examination.findings)
    names = {finding.code for finding in examination.wrong} | WARNED_OF.intersection(found_codes)
    passed = isinstance(found, ExaminedScan)
    mended = found if passed else _examine(folder, {**options, "repair": True}, executor, progress)
    return Examined(
        name=name,
        verdict=examination.verdict,
        codes=found_codes,
        sentence=" ".join(finding.sentence for finding in examination.findings),
        seconds=clock.seconds["examine"],
        named=bool(set(codes) & names) if codes else _is_right_of_right(examination, copy),
        usable=mended if isinstance(mended, ExaminedScan) else None,
    )


def _is_right_of_right(examination: Examination, copy: ScanCopy) -> bool:
    """Return whether a verdict on a right scan is right: what frames that share no view say can't be known."""
    return examination.verdict == "confirmed" or (examination.verdict == "unknown" and is_sparse(copy.scan))


def _examine(
    folder: Path, options: dict[str, Any], executor: Executor, progress: Progress
) -> ExaminedScan | RefusedScanError:
    parsed = parse_build_options(options)
    scan = open_scan(folder, parsed.format, parsed.scan)
    try:
        return examined_scan(folder, scan, options, executor, progress)
    except RefusedScanError as refused:
        return refused
