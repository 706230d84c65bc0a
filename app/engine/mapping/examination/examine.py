"""The examination of a scan: do its pictures, depth and poses agree, and if not, what would make them?"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.examination.agreement import Agreement, relative_poses
from app.engine.mapping.examination.consistency import judge_consistency
from app.engine.mapping.examination.depth_images import judge_depth_images
from app.engine.mapping.examination.depth_layout import OPTIONS as LAYOUT
from app.engine.mapping.examination.depth_layout import DepthLayout, judge_depth_layout, judge_rays
from app.engine.mapping.examination.depth_ratio import DepthRatio, measure_depth_ratio
from app.engine.mapping.examination.evidence import Evidence, FrameMatcher, gather_evidence
from app.engine.mapping.examination.gravity_direction import judge_gravity_direction
from app.engine.mapping.examination.outcome import Examination, Finding, Verdict
from app.engine.mapping.examination.scale_cause import Scales, judge_scale
from app.engine.mapping.examination.search import OPTIONS as SEARCH
from app.engine.mapping.examination.search import State, search_remedies
from app.engine.mapping.examination.sparseness import is_sparse, usual_turn_deg
from app.engine.mapping.examination.upright import judge_gravity
from app.engine.progress import Progress
from app.geometry.camera import REFERENCE_FOCAL_PX
from app.geometry.se3 import rotation_angle_deg
from app.importers.conventions import PoseArrays, PoseConvention
from app.importers.frames import Scan, ScanOptions
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class ExamineOptions:
    """When there is enough to judge by, and when poses stand still."""

    first_places: int = limit(
        6,
        "Places along the scan at which frames are compared first.",
        chosen="By hand: with three frames each, less than a tenth of the time of a build.",
    )
    first_side_px: int = limit(
        320,
        "Length to which a picture's longer side is reduced there.",
        chosen="By hand: two thirds of the time of 400, as maps and all further places have them.",
    )
    places: int = limit(
        16, "Places for a scan that the first ones don't confirm.", chosen="By hand: twice as many."
    )
    last_places: int = limit(
        48,
        "Places for a scan whose frames share too little.",
        chosen="By hand: a few pairs among them are enough.",
    )
    min_pairs: int = limit(4, "Pairs that an examination needs.", chosen="By hand: half of them may be odd.")
    min_matches: int = limit(120, "Matches that it needs.", chosen="By hand: thirty a pair.")
    still_px: float = limit(
        1.0,
        "Poses that would move the picture by less than this, at the focal length of reference, stand still.",
        chosen="By hand: the error of a match.",
    )
    moved_px: float = limit(
        12.0,
        "A picture that moved by more than this, at the focal length of reference, was moved.",
        chosen="By hand: far above the error of a match.",
    )
    frozen_share: float = limit(
        0.5, "Share of moved pairs whose poses stand still that makes a scan wrong.", chosen="By hand."
    )
    doubtful_share: float = limit(
        0.1, "The same for a scan that is doubtful: tracking was lost for a while.", chosen="By hand."
    )


OPTIONS = ExamineOptions()
BLANK_DEPTH = Finding(
    code="blank_depth",
    sentence="The depth images are blank where the pictures show anything: check depth_scale, the depth images and "
    "those of their confidence, or send the scan without any depth image.",
)


def examine_scan(
    scan: Scan,
    options: ScanOptions,
    gravity: tuple[float, float, float] | None,
    executor: Executor,
    progress: Progress,
    *,
    up_is_known: bool = False,
) -> Examination:
    """Examine a scan as it was read with `options`, before anything is built from it.

    `gravity` is the direction of down in the frame of its poses; `up_is_known` says that a transform to the world is
    given. Needs no map and no model; takes seconds: what a few places confirm is confirmed, all else is looked at in
    more places.
    """
    asked = not up_is_known

    def judge(frames: FrameMatcher, places: int) -> Examination:
        evidence = gather_evidence(frames, places, executor, progress)
        return _judge(evidence, frames, scan, options, gravity, asked)

    found = judge(FrameMatcher(scan, OPTIONS.first_side_px), OPTIONS.first_places)
    if found.verdict != "confirmed":
        frames = FrameMatcher(scan)
        found = judge(frames, OPTIONS.places)
        if found.verdict == "unknown" and len(scan.frames) > OPTIONS.places:
            found = judge(frames, OPTIONS.last_places)
    return found


def _judge(
    evidence: Evidence,
    frames: FrameMatcher,
    scan: Scan,
    options: ScanOptions,
    gravity: tuple[float, float, float] | None,
    asked: bool,
) -> Examination:
    poses = PoseArrays.of([frame.scan_from_camera for frame in scan.frames])
    if evidence.pairs < OPTIONS.min_pairs or len(evidence.pair) < OPTIONS.min_matches:
        return _unknown(evidence, scan, judge_gravity(poses, gravity, asked=asked))
    still = _frozen(evidence, scan, poses)
    if still and still[0].severity == "wrong":
        return _examined(evidence, None, None, still)
    if scan.has_depth and not (evidence.first_m.any() or evidence.second_m.any()):
        return _examined(evidence, None, None, [*still, BLANK_DEPTH])
    start = State(
        convention=options.convention,
        camera=scan.camera,
        poses=poses,
        times_s=np.array([frame.timestamp_s for frame in scan.frames]),
        evidence=evidence,
        trajectory=scan.trajectory,
    )
    searched = search_remedies(start)
    layout = judge_depth_layout(scan, searched.state, frames.pictures(LAYOUT.frames))
    findings = [*still, *searched.findings, *layout.findings]
    ratio = None
    # What is measured through wrong depth or wrong poses says nothing of scale and gravity.
    if searched.found.score <= SEARCH.wrong_score:
        if not layout.spoils_ratio:
            ratio, of_depth = _judge_depth(scan, options.convention, layout, searched.state)
            findings.extend(of_depth)
        if not any(finding.severity == "wrong" for finding in findings):
            moved = searched.state
            findings.extend(judge_consistency(frames, layout.evidence, moved.camera, moved.poses))
        findings.extend(_judge_up(searched.state, options.convention, gravity, asked=asked))
        if gravity is not None and not any(finding.severity == "wrong" for finding in findings):
            moved = searched.state
            findings.extend(judge_gravity_direction(scan, moved.camera, moved.poses, gravity))
    return _examined(evidence, searched.found, ratio, _or_flipped(findings))


def _or_flipped(findings: Sequence[Finding]) -> Sequence[Finding]:
    """Return the findings with flipped pictures in place of left-handed axes under which all pictures hang.

    By geometry alone the two are the same.
    """
    by_code = {finding.code: finding for finding in findings}
    axes, hanging = by_code.get("camera_axes"), by_code.get("gravity_up")
    if axes is None or hanging is None or axes.options.get("axes") != "unity":
        return findings
    flipped = Finding(
        code="mirrored_pictures",
        sentence="The pictures are mirrored, top for bottom, as a renderer's buffer often is: save them as the camera "
        'saw them. If they are not, the camera axes are those of Unity and gravity points up: give "axes": "unity" and '
        "gravity that points down.",
        figures=axes.figures,
    )
    return [flipped, *(finding for finding in findings if finding not in (axes, hanging))]


def _judge_depth(
    scan: Scan, convention: PoseConvention, layout: DepthLayout, state: State
) -> tuple[DepthRatio | None, list[Finding]]:
    """Return the ratio of triangulated to measured depth, and what is wrong with depth by poses that fit."""
    evidence = layout.evidence
    # Depth that belongs to no picture shows neither a scale nor what it measures.
    foreign = None if layout.findings else judge_depth_images(scan, evidence, state.rays(), state.poses)
    if foreign is not None and foreign.severity == "wrong":
        return None, [foreign]
    ratio = measure_depth_ratio(evidence, state.rays(), state.poses)
    # Depth is moved by steps of its own scale.
    steps = state.poses.positions / (1.0 if ratio is None else ratio.ratio)
    along_rays = judge_rays(evidence, state.rays(), PoseArrays(state.poses.rotations, steps))
    if along_rays is not None:
        return ratio, [along_rays]
    doubts = [] if foreign is None else [foreign]
    return ratio, doubts if ratio is None else [*doubts, *_scale_findings(scan, convention, ratio, state)]


def _judge_up(
    state: State, as_read: PoseConvention, gravity: tuple[float, float, float] | None, *, asked: bool
) -> list[Finding]:
    """Return what is wrong with gravity by poses that fit the pictures, whatever had to be mended for that."""
    if gravity is not None and state.convention.is_left_handed != as_read.is_left_handed:
        gravity = PoseConvention(axes="ruf").direction_in_own(gravity)
    return judge_gravity(state.poses, gravity, asked=asked)


def _examined(
    evidence: Evidence, found: Agreement | None, ratio: DepthRatio | None, findings: Sequence[Finding]
) -> Examination:
    ordered = sorted(findings, key=lambda finding: finding.severity != "wrong")
    severities = {finding.severity for finding in findings if finding.code != "up_is_not_z"}
    verdict: Verdict = "confirmed"
    if severities:
        verdict = "refused" if "wrong" in severities else "doubtful"
    return Examination(verdict=verdict, figures=_figures(evidence, found, ratio), findings=tuple(ordered))


def _unknown(evidence: Evidence, scan: Scan, up: Sequence[Finding]) -> Examination:
    sparse = (
        f" By the poses neighbouring frames are turned by {usual_turn_deg(scan):.0f} degrees from each other: record "
        "more frames, so that each shows half of what the one before it shows."
        if is_sparse(scan)
        else ""
    )
    finding = Finding(
        code="too_little_in_common",
        severity="doubtful",
        sentence=f"The scan could not be examined: of {evidence.tried} pairs of frames a little apart {evidence.pairs} "
        f"share enough texture to compare pictures, depth and poses.{sparse}",
    )
    refused = any(one.severity == "wrong" for one in up)
    return Examination(
        verdict="refused" if refused else "unknown",
        figures=_figures(evidence, None, None),
        findings=(*up, finding),
    )


def _figures(
    evidence: Evidence, found: Agreement | None, ratio: DepthRatio | None
) -> dict[str, float | int | None]:
    return {
        "pairs_tried": evidence.tried,
        "pairs": evidence.pairs,
        "matches": len(evidence.pair),
        "epipolar_error_px": None if found is None else round(found.error_px, 3),
        "usual_error_px": round(float(np.median(evidence.tolerance_px)), 3) if evidence.pairs else None,
        "score": None if found is None or not np.isfinite(found.score) else round(found.score, 3),
        "depth_ratio": None if ratio is None else round(ratio.ratio, 4),
        "depth_ratio_sigma": None if ratio is None else round(ratio.sigma, 4),
        "usual_depth_m": None if ratio is None else round(ratio.depth_m, 3),
    }


def _frozen(evidence: Evidence, scan: Scan, poses: PoseArrays) -> list[Finding]:
    """Return what is wrong with poses that stand still while the pictures move."""
    relative = relative_poses(evidence, poses)
    turned_rad = np.radians([rotation_angle_deg(rotation) for rotation in relative.rotations])
    # A step is seen as it would be at a metre.
    by_poses_px = (turned_rad + np.linalg.norm(relative.positions, axis=1)) * REFERENCE_FOCAL_PX
    moves = np.linalg.norm(evidence.first_px - evidence.second_px, axis=1)
    scale = scan.camera.focal_px / REFERENCE_FOCAL_PX
    seen_px = np.array([np.median(moves[evidence.pair == pair]) for pair in range(evidence.pairs)]) / scale
    moved = seen_px > OPTIONS.moved_px
    frozen = moved & (by_poses_px < OPTIONS.still_px)
    share = float(frozen.sum()) / max(int(moved.sum()), 1)
    if share < OPTIONS.doubtful_share or np.count_nonzero(frozen) < 2:
        return []
    return [
        Finding(
            code="poses_stand_still",
            severity="wrong" if share >= OPTIONS.frozen_share else "doubtful",
            sentence=f"The poses stand still while the pictures move, in {np.count_nonzero(frozen)} of "
            f"{np.count_nonzero(moved)} places that were compared: was tracking lost, or do several rows share a time "
            "that was printed with too few digits?",
            figures={"frozen_share": round(share, 3)},
        )
    ]


def _scale_findings(scan: Scan, convention: PoseConvention, ratio: DepthRatio, state: State) -> list[Finding]:
    steps = np.linalg.norm(np.diff(state.poses.positions, axis=0), axis=1)
    elapsed = np.diff(state.times_s)
    moving = elapsed > 1e-6
    scales = Scales(
        depth_scale=scan.depth.scale,
        position_scale=convention.position_scale,
        speed_m_s=float(np.median(steps[moving] / elapsed[moving])) if moving.any() else None,
    )
    found = judge_scale(ratio, scales)
    return [] if found is None else [found]
