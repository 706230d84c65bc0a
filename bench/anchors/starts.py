"""Sessions that an anchor alone starts: how the error grows from there by odometry, and the scale (C 4.2.7, 5.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from app.engine.anchors.features import AnchorFeatures
from app.engine.anchors.match_anchor import match_anchor
from app.engine.anchors.verification import judge_fix
from app.engine.mapping.frame_images import frame_rgb
from app.engine.progress import Progress
from app.engine.stage_timer import StageTimer
from app.engine.tracking.anchor_fixes import fix_of_anchor
from app.engine.tracking.fix import Fix, NoFix
from app.engine.tracking.frame import TrackingFrame
from app.engine.tracking.settings import TrackerSettings
from app.engine.tracking.surroundings import Surroundings
from app.engine.tracking.tracker import Tracker
from app.geometry.se3 import Pose, rotation_between
from app.importers.frames import Frame, Scan
from bench.anchors.pairs import AnchorPair, PairEvaluator
from bench.anchors.sequences import pair_with_pois
from bench.tracking.sequences import tracked_scale

Array = NDArray[np.float64]

# Monitoring frames that are tried for one start.
MONITORS = 40
# A shorter distance says nothing about the scale: the position's own noise is as large.
MIN_KNOWN_DISTANCE_M = 0.4
# At longer distances the position's noise, some centimetres, is less than 5 %.
LONG_DISTANCE_M = 0.7
# Error and stated sigma are reported by the length of the path since the start, in these steps.
PATH_STEPS_M = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0)


@dataclass(frozen=True, slots=True)
class StartedFrame:
    """A frame after the anchor was there: the path since, the error, and one sigma as stated, in metres."""

    path_m: float
    error_m: float
    sigma_m: float


@dataclass(frozen=True, slots=True)
class Start:
    """A session that an anchor started: its frames tracked by odometry alone, and the distance tracked between the two
    places furthest apart over the true one, None where that is too short; `scale_sigma` is the scale's sigma
    as the anchor states it, as a ratio."""

    name: str
    frames: tuple[StartedFrame, ...]
    scale: float | None
    distance_m: float | None
    scale_sigma: float


@dataclass(frozen=True, slots=True, kw_only=True)
class StartSettings:
    """How many starts, frames of each, of which the anchor can be asked on the first `anchored`, POIs of each anchor;
    which pairs are drawn; and whether POIs may lie anywhere, or only where somebody would put them."""

    starts: int = 20
    frames: int = 100
    anchored: int = 30
    pois: int = 1
    seed: int = 1
    anywhere: bool = False


class SessionRun(Protocol):
    """What tracks one session from the anchor of a pair on."""

    def __call__(
        self,
        scan: Scan,
        pair: AnchorPair,
        frames: Sequence[Frame],
        gravity: Array,
        settings: StartSettings,
        evaluator: PairEvaluator,
    ) -> Start | str:
        """Return the session, or why it never started."""
        ...


class _OneAnchor:
    """The fixes of one anchor, as long as it `is_open`."""

    def __init__(self, pair: AnchorPair, monitor: AnchorFeatures, evaluator: PairEvaluator) -> None:
        self._pair, self._monitor, self._evaluator = pair, monitor, evaluator
        self.is_open = True

    def locate(self, frame: TrackingFrame, camera: Any, _near: Any, _any_floor: bool = False) -> Fix | NoFix:
        """Return the anchor's fix of a frame."""
        if not self.is_open:
            return NoFix("no_map")
        pair, gravity = self._pair, np.array(frame.gravity)
        full = camera.scaled_to(frame.rgb.shape[1], frame.rgb.shape[0])
        phone = self._evaluator.phone_features(frame.rgb, gravity), full
        monitor = self._monitor, pair.monitor_camera
        found, _ = match_anchor(pair.spec, monitor, phone, gravity, None, StageTimer())
        if found is None:
            return NoFix("no_match")
        reason = judge_fix(found)
        if reason is not None:
            return NoFix(reason)
        fix = fix_of_anchor(found, pair.spec, pair.monitor_camera, frame, camera, pair.spec.floor_id)
        return fix or NoFix("too_few_inliers")

    def refresh(self, _frame: Any, _camera: Any, _predicted: Any) -> None:
        """Return that there is none."""

    def nearby(self, _frame: Any, _camera: Any, _near: Any, _reach_m: float) -> None:
        """Return that there is none."""


def evaluate_starts(
    scan: Scan,
    monitors: Sequence[Frame],
    video: Sequence[Frame],
    gravity_in_scan: Array,
    settings: StartSettings,
    evaluator: PairEvaluator,
    progress: Progress,
    run: SessionRun | None = None,
) -> list[Start | str]:
    """Start sessions at frames spread over a video, each by one frame of `monitors` as the only anchor, which can be
    asked on the first frames, and follow the video from there by odometry alone.

    Returns what became of each start: the reason where the anchor gave no fix. Frames that see none of what a
    monitor sees are no starts. `run` tracks one session; by default the service's tracker does.
    """
    rng = np.random.default_rng(settings.seed)
    last = max(len(video) - settings.frames, 1)
    outcomes: list[Start | str] = []
    for row in np.unique(np.linspace(0, last - 1, settings.starts).round().astype(int)):
        progress.report("anchor starts", len(outcomes), settings.starts)
        pair = _pair_for(rng, scan, gravity_in_scan, monitors, video[row], settings)
        if pair is None:
            continue
        frames = video[row : row + settings.frames]
        outcomes.append((run or _run)(scan, pair, frames, gravity_in_scan, settings, evaluator))
    progress.report("anchor starts", settings.starts, settings.starts)
    return outcomes


def _pair_for(
    rng: np.random.Generator,
    scan: Scan,
    gravity: Array,
    monitors: Sequence[Frame],
    phone: Frame,
    settings: StartSettings,
) -> AnchorPair | None:
    for _ in range(MONITORS):
        monitor = monitors[int(rng.integers(len(monitors)))]
        pair = pair_with_pois(rng, scan, gravity, monitor, phone, settings.pois, settings.anywhere)
        if pair is not None and len(pair.spec.pois) == settings.pois:
            return pair
    return None


def _run(
    scan: Scan,
    pair: AnchorPair,
    frames: Sequence[Frame],
    gravity: Array,
    settings: StartSettings,
    evaluator: PairEvaluator,
) -> Start | str:
    plan_from_scan = Pose(rotation_between(gravity, np.array([0.0, 0.0, -1.0])), np.zeros(3))
    source = _OneAnchor(pair, evaluator.monitor_features(pair), evaluator)
    tracker, around = Tracker(settings=TrackerSettings(use_refresh=False)), Surroundings(source)
    truth: list[Array] = []
    places: list[Array] = []
    started: list[StartedFrame] = []
    reason = "lost"
    for i, frame in enumerate(frames):
        source.is_open = i < settings.anchored
        down = frame.scan_from_camera.rotation.T @ gravity
        gravity_in_phone = float(down[0]), float(down[1]), float(down[2])
        rgb = frame_rgb(scan, frame)
        taken = TrackingFrame.of(rgb, frame.timestamp_s, gravity_in_phone, scan.camera)
        answer = tracker.process(taken, around)
        if answer.placed is None:
            reason = str(answer.reason)
            if source.is_open and i + 1 < settings.anchored:
                continue
            break
        truth.append((plan_from_scan @ frame.scan_from_camera).translation)
        places.append(answer.placed.frame_from_camera.translation)
        if not source.is_open:
            path_m = float(np.linalg.norm(np.diff(truth[-len(started) - 2 :], axis=0), axis=1).sum())
            # Anchors don't measure a phone's height: only the place on the plan counts.
            error_m = float(np.linalg.norm((places[-1] - truth[-1])[:2]))
            started.append(
                StartedFrame(path_m, error_m, 0.0 if answer.accuracy is None else answer.accuracy.position_m)
            )
    if not started:
        return reason
    scale, distance_m = tracked_scale(np.array(truth[-len(started) :]), np.array(places[-len(started) :]))
    if distance_m is None or distance_m < MIN_KNOWN_DISTANCE_M:
        scale = None
    return Start(pair.name, tuple(started), scale, distance_m, tracker.memory.fix_scale_sigma)


def growth_rows(starts: Sequence[Start]) -> list[list[str]]:
    """Return, for each stretch of path since the start, frames, median and 90 % error, the median of the stated
    sigma, and the share of frames within three sigmas."""
    frames = [frame for start in starts for frame in start.frames]
    rows = []
    for low, high in zip(PATH_STEPS_M, [*PATH_STEPS_M[1:], float("inf")], strict=True):
        some = [frame for frame in frames if low <= frame.path_m < high]
        if not some:
            continue
        errors = np.array([frame.error_m for frame in some])
        sigmas = np.array([frame.sigma_m for frame in some])
        until = f"{low:g}-{high:g}" if np.isfinite(high) else f"over {low:g}"
        rows.append(
            [
                until,
                str(len(some)),
                f"{100 * np.median(errors):.1f}",
                f"{100 * np.percentile(errors, 90):.1f}",
                *_stated(errors, sigmas),
            ]
        )
    return rows


def _stated(errors: Array, sigmas: Array) -> tuple[str, str]:
    """Return the median sigma in cm and the share within three of them, dashes where none is stated."""
    if np.isnan(sigmas).all():
        return "-", "-"
    return f"{100 * np.median(sigmas):.1f}", f"{100 * np.mean(errors <= 3 * sigmas):.1f}"


def summarize_starts(outcomes: Sequence[Start | str]) -> dict[str, Any]:
    """Return the figures of starts: how many were tried and located, and how the scale came out."""
    starts = [each for each in outcomes if isinstance(each, Start)]
    known = [start for start in starts if start.scale is not None]
    off = np.array([abs((start.scale or 1.0) - 1.0) for start in known])
    long = np.array([(start.distance_m or 0.0) >= LONG_DISTANCE_M for start in known], dtype=bool)
    claimed = np.array([start.scale_sigma for start in known])
    reasons = [each for each in outcomes if isinstance(each, str)]
    return {
        "starts": len(outcomes),
        "located": len(starts),
        "reasons": {reason: reasons.count(reason) for reason in sorted(set(reasons))},
        "frames followed, median": float(np.median([len(each.frames) for each in starts]))
        if starts
        else None,
        "with a known distance": len(known),
        "scale off by, median %": _percent(off, 50),
        "scale off by, 90 % of them %": _percent(off, 90),
        "stated sigma of the scale, median %": None if np.isnan(claimed).any() else _percent(claimed, 50),
        "scale within 5 %, % of them": _share(off <= 0.05),
        f"scale within 5 %, above {LONG_DISTANCE_M:g} m, % of them": _share(off[long] <= 0.05),
        f"  of distances above {LONG_DISTANCE_M:g} m": int(long.sum()),
        "scale within three sigmas, % of them": None
        if np.isnan(claimed).any()
        else _share(off <= 3 * claimed),
    }


def _percent(values: Array, share: float) -> float | None:
    return round(100 * float(np.percentile(values, share)), 2) if len(values) else None


def _share(values: NDArray[np.bool_]) -> float | None:
    return round(100 * float(np.mean(values)), 1) if len(values) else None
