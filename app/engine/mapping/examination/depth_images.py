"""Depth that is not the depth of its picture: of another frame, mirrored, turned, moved aside, or a disparity."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.examination.agreement import Rays, relative_poses
from app.engine.mapping.examination.depth_ratio import measure_depth_ratio
from app.engine.mapping.examination.evidence import ASIDE, FIELDS, Evidence, aside_px, in_field, with_depth
from app.engine.mapping.examination.outcome import Finding
from app.importers.conventions import PoseArrays
from app.importers.frames import Scan
from app.limits import limit

Array = NDArray[np.float64]
DepthImage = NDArray[np.float32]
MEASURED = (
    "By hand: on RedKitchen, freiburg1_rpy, desk_rs and the demonstration scan right depth has a share of up to 0.09, "
    "depth that was exchanged of 0.09 to 0.8; `roomfix examine-mistakes` makes these mistakes."
)
MEASURED_LATE = (
    "By hand: on parts of the same four scans the depth of the frame before or after costs 1.5 to 18 times as much as "
    "the right one, apart from a scan that hardly moves, where both cost the same; `roomfix "
    "examine-mistakes` makes this mistake."
)
MEASURED_FIELD = (
    "By hand: on parts of the same four scans right depth fits with 1.03 times its cost or more in another field of "
    "view, depth cut or enlarged by 10 to 25 % with 0.15 to 0.99 of its cost, and 0.15 to 0.84 after the search; "
    "`roomfix examine-mistakes` makes this mistake."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthImagesOptions:
    """When depth images are not those of their pictures."""

    apart_log: float = limit(
        0.1,
        "Depth that differs by more than this logarithm from another picture's depth moved there contradicts it.",
        chosen="By hand: sensors are off by up to 4 %.",
    )
    soft_log: float = limit(
        0.03,
        "Differences of this logarithm count half in the cost of a shift.",
        chosen="By hand: the noise of a sensor at three metres.",
    )
    min_matches: int = limit(
        200, "Matches with depth in both pictures that show whose depth it is.", chosen="By hand."
    )
    suspect_share: float = limit(
        0.05,
        "Share of matches whose depths contradict each other from which causes are tried.",
        chosen=MEASURED,
    )
    doubtful_share: float = limit(
        0.14, "The same from which a scan is doubtful without a known cause.", chosen=MEASURED
    )
    wrong_share: float = limit(0.2, "The same from which it is wrong.", chosen=MEASURED)
    cause_ratio: float = limit(
        0.5, "A cause must lower that share, and the cost, to less than this part of it.", chosen=MEASURED
    )
    late_suspect_share: float = limit(
        0.015, "As suspect_share, for depth of the frames next to a picture's own.", chosen=MEASURED_LATE
    )
    late_cost_ratio: float = limit(
        0.75, "Depth of another frame must lower the cost to less than this part of it.", chosen=MEASURED_LATE
    )
    most_frames: int = limit(3, "Depth of frames up to this far before or after is tried.", chosen="By hand.")
    aside_gain: float = limit(
        0.75,
        "Depth a little aside must fit with at most this part of the cost, for shifts to be searched for.",
        chosen=MEASURED,
    )
    shift_gain: float = limit(
        0.5, "Depth that is shifted must fit with at most this part of the cost.", chosen=MEASURED
    )
    shift_steps: int = limit(
        4, "Steps of a shift that are tried on each side, first.", chosen="By hand: up to 8 % of a picture."
    )
    field_suspect: float = limit(
        0.95, "As aside_gain, for depth nearer to the middle or farther from it.", chosen=MEASURED_FIELD
    )
    field_gain: float = limit(
        0.85,
        "Depth of another field of view must fit with at most this part of the cost.",
        chosen=MEASURED_FIELD,
    )
    field_step_log: float = limit(
        0.08,
        "Steps in which fields of view are tried, as a logarithm.",
        chosen="By hand: 26 px at the side of 640.",
    )
    field_steps: int = limit(4, "Such steps on each side, first.", chosen="By hand: a 16:9 cut is 0.29.")
    least_field_cost: float = limit(
        0.005,
        "Cost below which depths agree, whatever fits even better.",
        chosen="By hand: right depth of a rendered room without noise costs up to 0.0036, squeezed depth 0.006.",
    )
    least_field_log: float = limit(
        0.05,
        "Logarithm from which another field of view counts.",
        chosen="By hand: 16 px at the side of 640.",
    )
    least_shift_ratio: float = limit(
        0.012, "A shift counts from this part of the picture's longer side.", chosen="By hand: 8 px of 640."
    )


OPTIONS = DepthImagesOptions()


@dataclass(frozen=True, slots=True)
class DepthContradiction:
    """How depth of one picture, moved into another by the poses, contradicts the depth there.

    `share` is the share of matches that differ by more than the limit, `cost` (0 to 1) a smooth measure.
    """

    share: float
    cost: float


@dataclass(frozen=True, slots=True, kw_only=True)
class _Cause:
    code: str
    says: str
    depth_of: Callable[[int], DepthImage]
    cost_ratio: float = OPTIONS.cause_ratio


def judge_depth_images(scan: Scan, evidence: Evidence, rays: Rays, poses: PoseArrays) -> Finding | None:
    """Return that the depth images are not those of their pictures, with the cause that explains it best, or None."""
    found = _contradiction(evidence, rays, poses)
    if found is None:
        return None
    shift = _shift(scan, evidence, rays, poses, found)
    if shift is not None:
        return shift
    field = _field(scan, evidence, rays, poses, found)
    if field is not None or found.share < OPTIONS.late_suspect_share:
        return field
    causes = _causes(scan) if found.share >= OPTIONS.suspect_share else _late(scan, 1)
    explained = _explained(causes, evidence, rays, poses, found)
    if explained is not None:
        return explained
    if found.share < OPTIONS.doubtful_share:
        return None
    return Finding(
        code="depth_disagrees",
        severity="wrong" if found.share >= OPTIONS.wrong_share else "doubtful",
        sentence="The depth images contradict each other: moved from one picture into another, "
        f"{100 * found.share:.0f} % of the depths differ by more than {100 * OPTIONS.apart_log:.0f} % from the depth "
        "there, and no known mistake explains it: check that each depth image belongs to its picture and is registered "
        "to it.",
        figures={"contradicting_share": round(found.share, 3)},
    )


def _explained(
    causes: Iterator[_Cause], evidence: Evidence, rays: Rays, poses: PoseArrays, found: DepthContradiction
) -> Finding | None:
    """Return the cause with which the depths contradict each other least, where that is far less than as they are."""
    tried = [(cause, _contradiction(with_depth(evidence, cause.depth_of), rays, poses)) for cause in causes]
    known = [(cause, after) for cause, after in tried if after is not None]
    if not known:
        return None
    cause, after = min(known, key=lambda one: one[1].share)
    fits = after.share < OPTIONS.cause_ratio * found.share and after.cost < cause.cost_ratio * found.cost
    return _finding(cause, found, after) if fits and after.share < OPTIONS.suspect_share else None


def depth_contradiction(evidence: Evidence, rays: Rays, poses: PoseArrays) -> DepthContradiction | None:
    """Return how the depths of pairs contradict each other; None for too few matches with depth in both pictures.

    The positions must have the scale of the depth.
    """
    known = (evidence.first_m > 0) & (evidence.second_m > 0)
    if np.count_nonzero(known) < OPTIONS.min_matches:
        return None
    relative = relative_poses(evidence, poses)
    pair, first_m, second_m = evidence.pair[known], evidence.first_m[known], evidence.second_m[known]
    turned, moved = relative.rotations[pair], relative.positions[pair]
    there = np.einsum("mij,mj->mi", turned, rays.first[known] * first_m[:, None]) + moved
    back = np.einsum("mji,mj->mi", turned, rays.second[known] * second_m[:, None] - moved)
    apart = np.abs(
        np.log(
            np.concatenate([second_m / np.maximum(there[:, 2], 1e-6), first_m / np.maximum(back[:, 2], 1e-6)])
        )
    )
    return DepthContradiction(
        share=float(np.mean(apart > OPTIONS.apart_log)),
        cost=float(np.mean(apart**2 / (apart**2 + OPTIONS.soft_log**2))),
    )


def _contradiction(evidence: Evidence, rays: Rays, poses: PoseArrays) -> DepthContradiction | None:
    """Return the contradiction with steps of the depth's own scale, whatever that is."""
    ratio = measure_depth_ratio(evidence, rays, poses)
    scale = 1.0 if ratio is None else ratio.ratio
    return depth_contradiction(evidence, rays, PoseArrays(poses.rotations, poses.positions / scale))


def _causes(scan: Scan) -> Iterator[_Cause]:
    yield from _late(scan, OPTIONS.most_frames)
    depth_of = _depth_of(scan)
    for word, change in (
        ("mirrored, left for right,", (1, -1)),
        ("mirrored, top for bottom,", (-1, 1)),
        ("turned upside down", (-1, -1)),
    ):
        yield _Cause(
            code="depth_turned",
            says=f"The depth images are {word} against their colour pictures: save both as the camera saw them",
            depth_of=_turned(depth_of, change),
        )
    yield _Cause(
        code="depth_is_disparity",
        says="The depth images hold disparities or inverse depth, which grow towards the camera: convert them to depth",
        depth_of=lambda row: _inverted(depth_of(row)),
    )


def _late(scan: Scan, most_frames: int) -> Iterator[_Cause]:
    for frames in (*range(1, most_frames + 1), *range(-1, -most_frames - 1, -1)):
        word = f"{abs(frames)} frame{'s' if abs(frames) > 1 else ''} {'before' if frames > 0 else 'after'}"
        yield _Cause(
            code="depth_of_other_frames",
            says=f"The depth images are late or early: that of a picture is listed {word} it; pair colour and depth "
            "that were taken together",
            depth_of=_of_row(_depth_of(scan), frames),
            cost_ratio=OPTIONS.late_cost_ratio,
        )


def _depth_of(scan: Scan) -> Callable[[int], DepthImage]:
    last = len(scan.frames) - 1

    def depth_of(row: int) -> DepthImage:
        if 0 <= row <= last:
            return scan.depth_m(scan.frames[row])
        return np.zeros((scan.camera.height, scan.camera.width), np.float32)

    return depth_of


def _of_row(depth_of: Callable[[int], DepthImage], before: int) -> Callable[[int], DepthImage]:
    return lambda row: depth_of(row - before)


def _turned(depth_of: Callable[[int], DepthImage], steps: tuple[int, int]) -> Callable[[int], DepthImage]:
    return lambda row: np.ascontiguousarray(depth_of(row)[:: steps[0], :: steps[1]])


def _inverted(depth_m: DepthImage) -> DepthImage:
    return np.where(depth_m > 0, 1.0 / np.maximum(depth_m, 1e-6), 0.0).astype(np.float32)


def _finding(cause: _Cause, found: DepthContradiction, after: DepthContradiction) -> Finding:
    return Finding(
        code=cause.code,
        sentence=f"{cause.says}. As it is, {100 * found.share:.0f} % of the depths contradict those of another "
        f"picture, otherwise {100 * after.share:.0f} %.",
        figures={
            "contradicting_share": round(found.share, 3),
            "mended_contradicting_share": round(after.share, 3),
        },
    )


def _shift(
    scan: Scan, evidence: Evidence, rays: Rays, poses: PoseArrays, found: DepthContradiction
) -> Finding | None:
    """Return by how much depth must be moved aside to fit far better, where depth a little aside fits better."""
    aside = [_contradiction(evidence.with_aside(direction), rays, poses) for direction in range(len(ASIDE))]
    if not any(one is not None and one.cost < OPTIONS.aside_gain * found.cost for one in aside):
        return None
    depth = {int(row): scan.depth_m(scan.frames[row]) for row in {*evidence.first, *evidence.second}}
    step_px = aside_px(scan.camera)

    def cost(shift_px: tuple[float, float]) -> float:
        moved = with_depth(evidence, depth.__getitem__, lambda px: px - np.array(shift_px))
        one = _contradiction(moved, rays, poses)
        return 1.0 if one is None else one.cost

    steps = step_px * np.arange(-OPTIONS.shift_steps, OPTIONS.shift_steps + 1)
    costs = {(float(x), float(y)): cost((float(x), float(y))) for x in steps for y in steps}
    best = min(costs, key=costs.__getitem__)
    while step_px > 1.5:
        step_px /= 2.0
        near = {(best[0] + x * step_px, best[1] + y * step_px): 0.0 for x in (-1, 0, 1) for y in (-1, 0, 1)}
        costs.update({shift: cost(shift) for shift in near if shift not in costs})
        best = min(costs, key=costs.__getitem__)
    least_px = OPTIONS.least_shift_ratio * max(scan.camera.width, scan.camera.height)
    if costs[best] > OPTIONS.shift_gain * found.cost or np.hypot(*best) < least_px:
        return None
    before = scan.depth.shift_px
    shift = [round(before[0] + best[0]), round(before[1] + best[1])]
    return Finding(
        code="depth_shift",
        sentence=f"The depth images lie beside their colour pictures: depths of several pictures agree when depth is "
        f"moved by {best[0]:.0f} px to the right and {best[1]:.0f} px down; register the depth to the colour, or give "
        f'"depth_shift_px": {shift}.',
        options={"depth_shift_px": shift},
        certain=True,
        figures={"right_px": round(best[0], 1), "down_px": round(best[1], 1), "cost": round(costs[best], 3)},
    )


def _field(
    scan: Scan, evidence: Evidence, rays: Rays, poses: PoseArrays, found: DepthContradiction
) -> Finding | None:
    """Return the part of the view that depth covers, where depth of another field of view fits far better."""
    if found.cost < OPTIONS.least_field_cost:
        return None
    tried = [
        _contradiction(evidence.with_aside(len(ASIDE) + field), rays, poses) for field in range(len(FIELDS))
    ]
    if not any(one is not None and one.cost < OPTIONS.field_suspect * found.cost for one in tried):
        return None
    depth = {int(row): scan.depth_m(scan.frames[row]) for row in {*evidence.first, *evidence.second}}

    def cost(logs: tuple[float, float]) -> float:
        ratios = float(np.exp(logs[0])), float(np.exp(logs[1]))
        spread = with_depth(evidence, depth.__getitem__, lambda px: in_field(px, scan.camera, ratios))
        one = _contradiction(spread, rays, poses)
        return 1.0 if one is None else one.cost

    step = OPTIONS.field_step_log
    steps = step * np.arange(-OPTIONS.field_steps, OPTIONS.field_steps + 1)
    costs = {(float(x), float(y)): cost((float(x), float(y))) for x in steps for y in steps}
    best = min(costs, key=costs.__getitem__)
    for finer in (step / 2, step / 4):
        near = [(best[0] + x * finer, best[1] + y * finer) for x in (-1, 0, 1) for y in (-1, 0, 1)]
        costs.update({logs: cost(logs) for logs in near if logs not in costs})
        best = min(costs, key=costs.__getitem__)
    if costs[best] > OPTIONS.field_gain * found.cost or np.abs(best).max() < OPTIONS.least_field_log:
        return None
    wide, high = (float(np.exp(value)) for value in best)
    return Finding(
        code="depth_field",
        sentence=f"The depth images show another field of view than their colour pictures: depths of several pictures "
        f"agree when depth is taken to cover {100 / wide:.0f} % of the picture's width and {100 / high:.0f} % of its "
        "height, about the middle. Was it cut, or resized with another aspect ratio? Register the depth to the colour, "
        'or give "depth_camera".',
        figures={"width_ratio": round(1 / wide, 3), "height_ratio": round(1 / high, 3)},
    )
