"""The thesis's pipeline on pairs and on sessions, beside the service's own (C chapters 4 and 5)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from app.engine.anchors.features import AnchorDescriber
from app.engine.mapping.frame_images import frame_rgb
from app.geometry.se3 import Pose, rotation_between
from app.importers.frames import Frame, Scan
from app.vision.images import Rgb
from app.vision.local_features import Akaze
from bench.anchors.pairs import AnchorOutcome, AnchorPair, PairEvaluator
from bench.anchors.starts import MIN_KNOWN_DISTANCE_M, Start, StartedFrame, StartSettings
from bench.baselines.thesis_anchor import MonitorView, describe_phone, locate_by_thesis, most_similar
from bench.baselines.thesis_odometry import ThesisOdometry
from bench.tracking.sequences import tracked_scale

Array = NDArray[np.float64]
# The thesis states no uncertainty of its answers.
NOT_STATED = float("nan")
# The thesis's pictures have up to 1920 x 1080 pixels.
LARGEST_SIDE_PX = 1920


class AnchorPipeline(StrEnum):
    """What locates a phone by monitoring cameras."""

    DEFAULT = "default"
    THESIS = "thesis"


def thesis_describer() -> AnchorDescriber:
    """Return what extracts A-KAZE as the thesis does: from all pixels of a picture, and with no limit of features."""
    describer = AnchorDescriber()
    describer.akaze = Akaze(LARGEST_SIDE_PX)
    return describer


class ThesisEvaluator(PairEvaluator):
    """Locates the phones of pairs by the thesis's equations, each by its own anchor alone."""

    def evaluate(
        self, pair: AnchorPair, change: Callable[[Rgb], Rgb] | None = None, *, with_gravity: bool = True
    ) -> AnchorOutcome:
        """Locate one phone; without gravity its y axis is taken to be vertical, as in the thesis."""
        rgb = pair.phone() if change is None else change(pair.phone())
        camera = pair.phone_camera.scaled_to(rgb.shape[1], rgb.shape[0])
        phone = describe_phone(self.describer, rgb)
        monitor = most_similar(self.describer, [self.monitor_view(pair)], phone)
        fix = locate_by_thesis(monitor, phone, camera, pair.gravity_in_phone if with_gravity else None)
        return AnchorOutcome(
            pair=pair,
            error_m=float("inf")
            if fix is None
            else float(np.linalg.norm(fix.on_plan - pair.phone_on_plan[:2])),
            reason="no_match" if fix is None else None,
            position_sigma_m=NOT_STATED,
            confidence=0.0,
            inliers=0 if fix is None else fix.inliers,
        )

    def monitor_view(self, pair: AnchorPair) -> MonitorView:
        """Return what the thesis knows of a pair's monitoring camera."""
        return MonitorView(pair.spec, pair.monitor_camera, self.monitor_features(pair))


class ThesisSession:
    """One session: relocated whenever the anchor gives a fix, tracked by odometry from there (C 5.1, 5.2)."""

    def __init__(self, evaluator: PairEvaluator, pair: AnchorPair, camera_of_frames: Scan) -> None:
        self._describer = evaluator.describer
        self._camera = camera_of_frames.camera
        self._monitor = MonitorView(pair.spec, pair.monitor_camera, evaluator.monitor_features(pair))
        self._odometry: ThesisOdometry | None = None
        self.starts = 0

    def place(self, rgb: Rgb, gravity_in_phone: Array, is_open: bool) -> tuple[Array, Array] | None:
        """Return the place on the plan (2,), and in the axes of the session's last fix (3,), in metres."""
        phone = describe_phone(self._describer, rgb)
        if is_open:
            monitor = most_similar(self._describer, [self._monitor], phone)
            fix = locate_by_thesis(monitor, phone, self._camera, gravity_in_phone)
            if fix is not None:
                self._odometry = ThesisOdometry(fix, phone, self._camera)
                self.starts += 1
                return fix.on_plan, np.zeros(3)
        tracked = None if self._odometry is None else self._odometry.track(phone)
        return None if tracked is None else (tracked[0], tracked[1].translation)


def run_thesis_session(
    scan: Scan,
    pair: AnchorPair,
    frames: Sequence[Frame],
    gravity: Array,
    settings: StartSettings,
    evaluator: PairEvaluator,
) -> Start | str:
    """Track one session by the thesis's equations; the reason where it never starts or is lost at once."""
    plan_from_scan = Pose(rotation_between(gravity, np.array([0.0, 0.0, -1.0])), np.zeros(3))
    session = ThesisSession(evaluator, pair, scan)
    truth: list[Array] = []
    places: list[Array] = []
    started: list[StartedFrame] = []
    for i, frame in enumerate(frames):
        down = frame.scan_from_camera.rotation.T @ gravity
        found = session.place(frame_rgb(scan, frame), down, i < settings.anchored)
        if found is None:
            if i + 1 < settings.anchored:
                continue
            break
        if i < settings.anchored:
            continue
        truth.append((plan_from_scan @ frame.scan_from_camera).translation)
        places.append(found[1])
        path_m = float(np.linalg.norm(np.diff(truth, axis=0), axis=1).sum()) if len(truth) > 1 else 0.0
        started.append(StartedFrame(path_m, float(np.linalg.norm(found[0] - truth[-1][:2])), NOT_STATED))
    if not started:
        return "lost" if session.starts else "no_match"
    scale, distance_m = tracked_scale(np.array(truth), np.array(places))
    if distance_m is None or distance_m < MIN_KNOWN_DISTANCE_M:
        scale = None
    return Start(pair.name, tuple(started), scale, distance_m, NOT_STATED)
