"""Depth that is laid out another way: bytes exchanged, beside its picture, or along the rays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.examination.agreement import Rays, relative_poses
from app.engine.mapping.examination.depth_shift import SmallPicture, measure_depth_shift
from app.engine.mapping.examination.evidence import Evidence, with_depth
from app.engine.mapping.examination.outcome import Finding
from app.engine.mapping.examination.search import State
from app.engine.mapping.frame_images import frame_rgb
from app.importers.conventions import PoseArrays
from app.importers.frames import Scan
from app.limits import limit
from app.vision.images import to_gray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthLayoutOptions:
    """When depth is laid out another way."""

    frames: int = limit(10, "Frames whose depth is looked at whole.", chosen="By hand: a second of work.")
    smooth_log: float = limit(
        0.02, "Neighbouring depths whose logarithms differ by less lie on one surface.", chosen="By hand."
    )
    smoother: float = limit(
        0.1,
        "Exchanged bytes must make this share of neighbours more lie on one surface.",
        chosen="By hand: right depth gets rougher by 0.15 or more on all scans of docs/figures/examine-mistakes.md.",
    )
    shift_ratio: float = limit(
        0.015, "A shift counts from this part of the picture's longer side.", chosen="By hand: 10 px of 640."
    )
    shift_peak: float = limit(
        5.5,
        "Standard deviations by which edges must agree at the shift.",
        chosen="By hand: right scans reach 6 to 12.",
    )
    shift_gain: float = limit(1.5, "And by which they must agree better than unmoved.", chosen="By hand.")
    min_ray_matches: int = limit(
        200, "Matches with depth in both pictures that show what depth is.", chosen="By hand."
    )
    ray_gain: float = limit(
        1.2,
        "How much better depth of two pictures must agree as distances along the rays than as depth.",
        chosen="By hand: between right scans, up to 0.63, and scans with distances, from 1.38 on, that were tried.",
    )


OPTIONS = DepthLayoutOptions()


@dataclass(frozen=True, slots=True)
class DepthLayout:
    """What is wrong with the layout, and the evidence with depth as it should be."""

    evidence: Evidence
    findings: tuple[Finding, ...]

    @property
    def spoils_ratio(self) -> bool:
        """Whether depth, as it is, can't be compared with what the poses triangulate."""
        return any(finding.code == "depth_shift" for finding in self.findings)


def judge_depth_layout(scan: Scan, state: State, pictures: Sequence[SmallPicture]) -> DepthLayout:
    """Return what is wrong with how the scan's depth images are laid out; the state has poses and camera that fit.

    `pictures` are some of the scan's.
    """
    rows = sorted({*np.linspace(0, len(scan.frames) - 1, OPTIONS.frames).round().astype(int).tolist()})
    exchanged = replace(scan, depth=replace(scan.depth, swap_bytes=not scan.depth.swap_bytes))
    gains = [_smoothness(exchanged, row) - _smoothness(scan, row) for row in rows[::4]]
    evidence, findings, source = state.evidence, list[Finding](), scan
    if np.median(gains) > OPTIONS.smoother:
        source = exchanged
        pictures = [_small_picture(source, row) for row in rows]
        evidence = with_depth(evidence, lambda row: exchanged.depth_m(exchanged.frames[row]))
        findings.append(
            Finding(
                code="depth_byte_order",
                sentence="The two bytes of each depth value are exchanged: with them the other way round neighbouring "
                f'pixels lie on one surface; give "swap_depth_bytes": {_json(source.depth.swap_bytes)}.',
                options={"swap_depth_bytes": source.depth.swap_bytes},
                certain=True,
                figures={"smoother": round(float(np.median(gains)), 3)},
            )
        )
    shift = _shift(source, pictures)
    return DepthLayout(evidence, (*findings, *([] if shift is None else [shift])))


def _smoothness(scan: Scan, row: int) -> float:
    """Return the share of neighbouring pixels that lie on one surface."""
    depth_m = scan.depth_m(scan.frames[row])
    a, b = depth_m[:, 1:], depth_m[:, :-1]
    known = (a > 0) & (b > 0)
    if not known.any():
        return 0.0
    return float(np.mean(np.abs(np.log(a[known] / b[known])) < OPTIONS.smooth_log))


def _small_picture(scan: Scan, row: int) -> SmallPicture:
    frame = scan.frames[row]
    return SmallPicture.of(to_gray(frame_rgb(scan, frame)), scan.depth_m(frame))


def _shift(scan: Scan, pictures: Sequence[SmallPicture]) -> Finding | None:
    found = measure_depth_shift(pictures)
    if found is None or found.peak < OPTIONS.shift_peak or found.peak < found.unmoved + OPTIONS.shift_gain:
        return None
    least_px = OPTIONS.shift_ratio * max(scan.camera.width, scan.camera.height)
    if np.hypot(found.right_px, found.down_px) < least_px:
        return None
    before = scan.depth.shift_px
    shift = [round(before[0] + found.right_px), round(before[1] + found.down_px)]
    return Finding(
        code="depth_shift",
        sentence=f"The depth images lie beside their colour pictures: edges meet when depth is moved by "
        f"{found.right_px:.0f} px to the right and {found.down_px:.0f} px down; register the depth to the colour, or "
        f'give "depth_shift_px": {shift}.',
        options={"depth_shift_px": shift},
        certain=True,
        figures={"right_px": found.right_px, "down_px": found.down_px, "peak": round(found.peak, 2)},
    )


def judge_rays(evidence: Evidence, rays: Rays, poses: PoseArrays) -> Finding | None:
    """Return that depth holds distances along the rays, where the depth of one picture moved into another shows it."""
    gain = along_rays_gain(evidence, rays, poses)
    return _along_rays(gain) if gain is not None and gain > OPTIONS.ray_gain else None


def along_rays_gain(evidence: Evidence, rays: Rays, poses: PoseArrays) -> float | None:
    """Return how much better the depth of one picture, moved into the other, fits there as distances along the rays.

    The median difference of the logarithms as depth along the axis, over that as distances; None for too few matches.
    """
    known = (evidence.first_m > 0) & (evidence.second_m > 0)
    if np.count_nonzero(known) < OPTIONS.min_ray_matches:
        return None
    relative = relative_poses(evidence, poses)
    pair, first_m, second_m = evidence.pair[known], evidence.first_m[known], evidence.second_m[known]
    points = rays.first[known] * first_m[:, None]
    lengths = np.linalg.norm(rays.first[known], axis=1, keepdims=True)

    def moved(source: Array) -> Array:
        turned = np.einsum("mij,mj->mi", relative.rotations[pair], source)
        return np.asarray(turned + relative.positions[pair])

    along_axis = np.maximum(moved(points)[:, 2], 1e-6)
    along_ray = np.maximum(np.linalg.norm(moved(points / lengths), axis=1), 1e-6)
    off_axis, off_ray = (
        float(np.median(np.abs(np.log(second_m / expected)))) for expected in (along_axis, along_ray)
    )
    return off_axis / max(off_ray, 1e-6)


def _along_rays(gain: float) -> Finding:
    return Finding(
        code="depth_along_rays",
        sentence="The depth images hold distances along the rays, not depth along the optical axis: they are too large "
        'by what a ray is longer than its depth; give "depth_along_rays": true.',
        options={"depth_along_rays": True},
        certain=True,
        figures={"gain": round(gain, 3)},
    )


def _json(value: bool) -> str:
    return "true" if value else "false"
