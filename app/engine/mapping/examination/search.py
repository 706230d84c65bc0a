"""The search for what is wrong with poses or camera: every remedy is judged by the same score on the same pairs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.examination.agreement import Agreement, Rays, agreement, misfit
from app.engine.mapping.examination.camera_fit import (
    fit_focal,
    fit_principal_point,
    turned_intrinsics,
)
from app.engine.mapping.examination.camera_mount import fit_camera_mount, joined_deg
from app.engine.mapping.examination.evidence import Evidence
from app.engine.mapping.examination.outcome import Finding
from app.engine.mapping.examination.readings import other_orders, other_readings
from app.engine.mapping.examination.time_offset import Track, fit_time_offset, offset_changes
from app.geometry.camera import Camera
from app.geometry.intrinsics_check import square_pixels
from app.importers.association import Trajectory
from app.importers.conventions import PoseArrays, PoseConvention
from app.limits import limit

Array = NDArray[np.float64]
# Fits of one camera, of which the one with the fewest numbers is taken.
_CAMERA_CODES = {"focal_length", "turned_intrinsics", "principal_point"}
# Cameras of few unknowns: a mount of three unknowns that fits as well says nothing against them.
_SIMPLER_THAN_MOUNT = {"focal_length", "turned_intrinsics"}
_MEASURED = (
    "By hand, between right scans and mistakes; checked by roomfix examine-mistakes "
    "(docs/figures/examine-mistakes.md)."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchOptions:
    """When a remedy is believed."""

    right_score: float = limit(0.7, "A scan with at most this score is right.", chosen=_MEASURED)
    wrong_score: float = limit(
        1.0, "A scan with more than this is wrong, even if nothing explains it.", chosen=_MEASURED
    )
    reading_gain: float = limit(
        3.0, "Another reading of the poses must lower the score by this factor.", chosen=_MEASURED
    )
    fit_gain: float = limit(
        1.25, "A fitted focal length or time offset must lower it by this one.", chosen=_MEASURED
    )
    point_gain: float = limit(
        1.5, "A principal point turned by a quarter must lower it by this one.", chosen=_MEASURED
    )
    free_point_gain: float = limit(
        2.5,
        "A principal point that is fitted must lower it by this one.",
        chosen="By hand: on twelve right frames of tum_fr1_rpy, three free numbers lower it by 1.9.",
    )
    exact_ratio: float = limit(
        2.0,
        "Poses whose error is below this many times that of the matches are read as they are meant.",
        chosen="By hand: a mistake leaves ten times as much.",
    )
    contest_ratio: float = limit(
        1.5,
        "A remedy is beyond doubt when the next one's score is this many times its own.",
        chosen=_MEASURED,
    )
    least_focal_log: float = limit(
        0.07,
        "Logarithm of the factor from which a focal length is wrong.",
        chosen="By hand: lens distortion that is not stated looks like 3 %.",
    )
    least_point_ratio: float = limit(
        0.05, "A principal point is wrong from this part of the picture's longer side.", chosen="By hand."
    )
    least_offset_s: float = limit(
        0.03,
        "A time offset is wrong from this.",
        chosen="By hand: a frame of video, and the rolling shutter.",
    )


OPTIONS = SearchOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class State:
    """How the scan is read at one point of the search; `times_s` (n,) are the frames'.

    `trajectory` holds the rows that the poses are from, as they are written, where a format has more of them than
    frames.
    """

    convention: PoseConvention
    camera: Camera
    poses: PoseArrays
    times_s: Array
    evidence: Evidence
    trajectory: Trajectory | None = None

    def rays(self) -> Rays:
        """Return the matches' rays by the camera."""
        return Rays.of(self.evidence, self.camera)

    def agreement(self) -> Agreement:
        """Return how well the state explains the matches."""
        return agreement(self.evidence, self.rays(), self.poses)


@dataclass(frozen=True, slots=True, kw_only=True)
class Remedy:
    """A change of the state, with its score times a penalty for how rare or how free it is.

    `is_determined` is false where the matches leave its numbers open.
    """

    code: str
    says: str
    options: dict[str, Any]
    state: State
    found: Agreement
    penalty: float = 1.0
    least_gain: float = 1.0
    is_determined: bool = True

    @property
    def weighted(self) -> float:
        """The score that remedies are ranked by."""
        return self.found.score * self.penalty


@dataclass(frozen=True, slots=True)
class Searched:
    """The state that explains the matches best, what had to be changed for it, and the last remedies' ranking."""

    state: State
    found: Agreement
    findings: tuple[Finding, ...]


def search_remedies(start: State, rounds: int = 3) -> Searched:
    """Change the state as long as one remedy makes the scan agree much better than before.

    A scan that agrees neither as it is nor after any remedy gets the finding `poses_disagree`.
    """
    state, found, findings = start, start.agreement(), list[Finding]()
    for _ in range(rounds):
        remedies = sorted(_believed(state, found), key=lambda remedy: remedy.weighted)
        if not remedies:
            break
        best = remedies[0]
        contest = [
            other
            for other in remedies[1:]
            if not {best.code, other.code} <= _CAMERA_CODES
            and not (other.code == "camera_mount" and best.code in _SIMPLER_THAN_MOUNT)
            and other.weighted < OPTIONS.contest_ratio * max(best.weighted, 0.02)
            and other.options != best.options
            and other.code != best.code
        ]
        findings.append(_finding(best, contest, found))
        state, found = best.state, best.found
    # Few pairs leave open whether a score that is a little too high is chance.
    is_doubtful = not found.least_score <= OPTIONS.right_score
    if is_doubtful or found.score > OPTIONS.wrong_score:
        findings.append(_unexplained(found, start))
    return Searched(state, found, tuple(findings))


def _believed(state: State, before: Agreement) -> Iterator[Remedy]:
    noise_px = float(np.median(state.evidence.noise_px))
    discrete: Iterator[Remedy] = chain(_readings(state), _orders(state))
    # Poses with the error of the matches themselves can't be read any better.
    if before.error_px < OPTIONS.exact_ratio * noise_px and np.isfinite(before.score):
        discrete = iter(())
    # No camera and no time makes matches agree better than they do under their own epipolar geometry.
    floor = float(np.median(state.evidence.noise_px / state.evidence.tolerance_px))
    fits = iter(()) if before.score <= OPTIONS.fit_gain * floor else _fits(state)
    for remedy in chain(discrete, fits):
        good = remedy.found.score <= OPTIONS.right_score
        if good and remedy.found.score * remedy.least_gain <= before.score:
            yield remedy


def _readings(state: State) -> Iterator[Remedy]:
    written = state.convention.written(state.poses)
    cameras = [state.camera, *turned_intrinsics(state.camera)]
    rays = [Rays.of(state.evidence, camera) for camera in cameras]
    for reading in other_readings(state.convention):
        poses = reading.convention.read(written)
        # Pictures that were turned often keep the numbers of the camera as it was.
        count = len(cameras) if reading.code == "turned_pictures" else 1
        for camera, own in zip(cameras[:count], rays[:count], strict=True):
            changed = camera is not state.camera
            yield Remedy(
                code=reading.code,
                says=reading.says + (", and the camera is that of the pictures before" if changed else ""),
                options={**reading.options, **(_camera_option(camera) if changed else {})},
                state=replace(state, convention=reading.convention, poses=poses, camera=camera),
                found=agreement(state.evidence, own, poses),
                penalty=reading.penalty * (1.2 if changed else 1.0),
                least_gain=OPTIONS.reading_gain,
            )


def _orders(state: State) -> Iterator[Remedy]:
    rays = state.rays()
    names = [str(time) for time in state.times_s]
    for says, poses in other_orders(names, state.poses):
        yield Remedy(
            code="pose_order",
            says=says,
            options={},
            state=replace(state, poses=poses),
            found=agreement(state.evidence, rays, poses),
            least_gain=OPTIONS.reading_gain,
        )


def _fits(state: State) -> Iterator[Remedy]:
    yield from _cameras(state)
    yield from _mounts(state)
    yield from _time_offsets(state)


def _cameras(state: State) -> Iterator[Remedy]:
    before = state.camera
    focal = fit_focal(state.evidence, before, state.poses)
    ratio = focal.params[0] / before.params[0]
    if abs(np.log(ratio)) > OPTIONS.least_focal_log:
        yield _of_camera(
            state, focal, "focal_length", _focal_words(before, focal), penalty=1.0, gain=OPTIONS.fit_gain
        )
    for camera in square_pixels(before):
        yield _of_camera(
            state, camera, "focal_length", _square_words(before, camera), penalty=1.0, gain=OPTIONS.fit_gain
        )
    for camera in turned_intrinsics(before):
        words = "The principal point is that of the picture turned by a quarter"
        yield _of_camera(state, camera, "turned_intrinsics", words, penalty=1.0, gain=OPTIONS.point_gain)
    point = fit_principal_point(state.evidence, before, state.poses)
    moved = float(np.abs(point.principal_point_px - before.principal_point_px).max())
    if moved > OPTIONS.least_point_ratio * max(before.width, before.height):
        words = (
            f"{_focal_words(before, point)}, with its principal point near ({point.params[2]:.0f}, "
            f"{point.params[3]:.0f}) instead of ({before.params[2]:.0f}, {before.params[3]:.0f})"
        )
        yield _of_camera(state, point, "principal_point", words, penalty=1.3, gain=OPTIONS.free_point_gain)


def _of_camera(state: State, camera: Camera, code: str, says: str, *, penalty: float, gain: float) -> Remedy:
    changed = replace(state, camera=camera)
    return Remedy(
        code=code,
        says=says,
        options=_camera_option(camera),
        state=changed,
        found=changed.agreement(),
        penalty=penalty,
        least_gain=gain,
    )


def _focal_words(before: Camera, after: Camera) -> str:
    return (
        f"The focal length that fits the pictures is {after.focal_px:.0f} px, {after.focal_px / before.focal_px:.3g} "
        f"times the stated {before.focal_px:.0f} px"
    )


def _square_words(before: Camera, after: Camera) -> str:
    return (
        f"The focal lengths {before.params[0]:.0f} and {before.params[1]:.0f} px differ, and the pixels are square: "
        f"both are near {after.params[0]:.0f} px"
    )


def _camera_option(camera: Camera) -> dict[str, Any]:
    values = [round(value, 3) for value in camera.params[:4]] + list(camera.params[4:])
    return {
        "camera": {"model": camera.model, "width": camera.width, "height": camera.height, "params": values}
    }


def _mounts(state: State) -> Iterator[Remedy]:
    mount = fit_camera_mount(state.evidence, state.camera, state.poses)
    if mount is None:
        return
    vector_deg = joined_deg(state.convention.mount_deg, mount.vector_deg)
    changed = replace(
        state,
        poses=mount.applied(state.poses),
        convention=replace(state.convention, mount_deg=vector_deg),
    )
    angle_deg = float(np.linalg.norm(mount.vector_deg))
    yield Remedy(
        code="camera_mount",
        says=f"The camera is mounted at an angle of {angle_deg:.1f} degrees to the body whose poses the scan holds",
        options={"mount_deg": list(vector_deg)},
        state=changed,
        found=changed.agreement(),
        penalty=1.3,
        least_gain=OPTIONS.fit_gain,
        is_determined=mount.is_certain,
    )


def _time_offsets(state: State) -> Iterator[Remedy]:
    if len(state.times_s) < 3:
        return
    track = (
        Track.of_frames(state.times_s, state.poses, state.convention)
        if state.trajectory is None
        else Track.of_rows(state.trajectory, state.convention)
    )
    offset_s = fit_time_offset(state.evidence, state.camera, track, state.times_s)
    if offset_s is None or abs(offset_s) < OPTIONS.least_offset_s:
        return
    poses, inside = track.at(state.times_s + offset_s)
    within = inside[state.evidence.first] & inside[state.evidence.second]
    evidence = state.evidence.of_pairs(within)
    rays = Rays.of(evidence, state.camera)
    # The same pairs as they are: those that are left out may be the worse ones.
    as_it_is = misfit(evidence, rays, state.poses)
    if misfit(evidence, rays, poses) * OPTIONS.fit_gain > as_it_is:
        return
    total_s = state.convention.time_offset_s + offset_s
    word = "late" if offset_s > 0 else "early"
    changes = offset_changes(state.evidence, state.camera, track, state.times_s)
    yield Remedy(
        code="time_offset",
        says=f"The times of the poses are {abs(offset_s):.3f} s {word}: the pose of a picture is found "
        f"{abs(offset_s):.3f} s {'after' if offset_s > 0 else 'before'} its time"
        + (", but the offset changes within the scan: the two clocks don't run alike" if changes else ""),
        options={"time_offset_s": round(total_s, 3)},
        state=replace(
            state,
            poses=poses,
            evidence=evidence,
            trajectory=None if state.trajectory is None else state.trajectory.moved(offset_s),
            convention=replace(state.convention, time_offset_s=total_s),
        ),
        found=agreement(evidence, rays, poses),
        least_gain=OPTIONS.fit_gain,
        is_determined=not changes,
    )


def _finding(best: Remedy, contest: list[Remedy], before: Agreement) -> Finding:
    error = (
        f"{best.says}: matches are then {best.found.error_px:.2g} px from their epipolar lines, as it is "
        f"{before.error_px:.2g} px"
    )
    option = ", ".join(f'"{name}": {_json(value)}' for name, value in best.options.items())
    sentence = error + (f"; give {option}." if option else ".")
    if contest:
        sentence += f" As well fits: {contest[0].says[0].lower()}{contest[0].says[1:]}."
    return Finding(
        code=best.code,
        sentence=sentence,
        options=best.options,
        certain=bool(best.options) and best.is_determined and not contest,
        figures={
            "error_px": round(before.error_px, 3),
            "mended_error_px": round(best.found.error_px, 3),
        },
    )


def _json(value: object) -> str:
    import json

    return json.dumps(value)


def _unexplained(found: Agreement, start: State) -> Finding:
    wrong = found.score > OPTIONS.wrong_score
    allowed = OPTIONS.right_score * float(np.median(start.evidence.tolerance_px))
    return Finding(
        code="poses_disagree",
        severity="wrong" if wrong else "doubtful",
        sentence=f"The poses don't fit the pictures: matches are {found.error_px:.2g} px from their epipolar lines, "
        f"where up to {allowed:.2g} px are usual, and no known mistake explains it: check the poses, their times "
        "and the camera.",
        figures={"error_px": round(found.error_px, 3)},
    )
