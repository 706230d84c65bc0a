"""Queries as phones send them: without intrinsics but with EXIF, its focal length more or less wrong, and turned."""

from __future__ import annotations

import io
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from PIL import Image

from app.engine.mapping.build_map import build_map
from app.engine.mapping.frame_images import frame_rgb
from app.engine.mapping.options import BuildOptions
from app.engine.mapping.self_check import check_map
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import Progress
from app.engine.query.camera_sources import query_camera
from app.engine.query.localizer import Localizer
from app.engine.query.upright import localize_upright
from app.geometry.camera import Camera
from app.geometry.camera_hint import CameraHint, hint_of
from app.geometry.se3 import Pose
from app.geometry.turns import camera_from_turned, turned_camera
from app.vision.exif import EXIF_IFD, FOCAL_LENGTH, PIXEL_X, PIXEL_Y, PLANE_UNIT, PLANE_X_RESOLUTION
from app.vision.images import Rgb
from bench.evaluation.dataset import Split
from bench.evaluation.outcome import outcome_of
from bench.evaluation.pose_errors import ErrorSummary, summarize

PHONE_FOCAL_MM = 4.2
MILLIMETRE = 4
WORLD_DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True, slots=True)
class PhoneCase:
    """How queries are sent: with the camera, with EXIF whose focal length has a relative error, or with neither
    (`exif_error` None); turned by quarters counter-clockwise; with gravity or not."""

    name: str
    with_camera: bool = False
    exif_error: float | None = None
    turns: int = 0
    with_gravity: bool = False


CASES = (
    PhoneCase("camera in the request", with_camera=True),
    *(PhoneCase(f"EXIF, focal {100 * e:+.0f} %", exif_error=e) for e in (0.0, 0.03, -0.03, 0.08, -0.08)),
    PhoneCase("search"),
    *(
        PhoneCase(f"turned {90 * turns}, {'with' if g else 'no'} gravity", True, None, turns, g)
        for turns in (1, 2, 3)
        for g in (False, True)
    ),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class PhoneFigures:
    """The figures of one case: the errors, the focal length's median and largest error in percent, the median of
    error over stated accuracy, and where the cameras came from."""

    case: str
    summary: ErrorSummary
    focal_median_percent: float | None
    focal_max_percent: float | None
    error_over_sigma: float | None
    sources: dict[str, int]

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for JSON."""
        return asdict(self)


def evaluate_phones(
    split: Split,
    options: BuildOptions,
    models: VisionModels,
    executor: Executor,
    progress: Progress,
    cases: Sequence[PhoneCase] = CASES,
) -> list[PhoneFigures]:
    """Build the map, then locate all queries in each case."""
    built = build_map(split.database, options, models, executor, progress)
    check = check_map(built, split.database, models, executor, progress)
    localizer = Localizer.of(check.stated_in(built.artifact), built.index, models)
    return [_figures(case, localizer, split, built.world_from_scan, progress) for case in cases]


def _figures(
    case: PhoneCase, localizer: Localizer, split: Split, world_from_scan: Pose, progress: Progress
) -> PhoneFigures:
    outcomes, focal, shares, sources = [], [], [], Counter[str]()
    true_focal_px = split.database.camera.focal_px
    for done, frame in enumerate(split.queries):
        progress.report(case.name, done, len(split.queries))
        truth = world_from_scan @ frame.scan_from_camera @ camera_from_turned(case.turns)
        rgb = np.ascontiguousarray(np.rot90(frame_rgb(split.database, frame), case.turns))
        gravity = truth.rotation.T @ WORLD_DOWN
        known = query_camera(*_sent(case, split.database.camera, rgb))
        started = time.perf_counter()
        found = localize_upright(
            localizer,
            rgb,
            known.camera,
            (float(gravity[0]), float(gravity[1]), float(gravity[2])) if case.with_gravity else None,
        )
        milliseconds = 1e3 * (time.perf_counter() - started)
        sources[known.source_of(found.camera)] += 1
        outcome = outcome_of(frame.name, found, truth, milliseconds)
        if outcome.located and found.camera is not None and found.accuracy is not None:
            focal.append(100 * abs(found.camera.focal_px / true_focal_px - 1))
            shares.append(outcome.position_m / found.accuracy.position_m)
        outcomes.append(outcome)
    progress.report(case.name, len(split.queries), len(split.queries))
    return PhoneFigures(
        case=case.name,
        summary=summarize(outcomes),
        focal_median_percent=round(float(np.median(focal)), 2) if focal else None,
        focal_max_percent=round(float(np.max(focal)), 2) if focal else None,
        error_over_sigma=round(float(np.median(shares)), 2) if shares else None,
        sources=dict(sources),
    )


def _sent(case: PhoneCase, camera: Camera, rgb: Rgb) -> tuple[CameraHint | None, Rgb, bytes]:
    """Return the camera of the request, the image, and the bytes that its EXIF is read from."""
    if case.with_camera:
        return hint_of(turned_camera(camera, case.turns)), rgb, b""
    return None, rgb, b"" if case.exif_error is None else _photo(rgb, camera, case.exif_error)


def _photo(rgb: Rgb, camera: Camera, exif_error: float) -> bytes:
    exif = Image.Exif()
    exif[EXIF_IFD] = {
        FOCAL_LENGTH: PHONE_FOCAL_MM * (1.0 + exif_error),
        PLANE_X_RESOLUTION: camera.focal_px / PHONE_FOCAL_MM,
        PLANE_UNIT: MILLIMETRE,
        PIXEL_X: camera.width,
        PIXEL_Y: camera.height,
    }
    buffer = io.BytesIO()
    Image.fromarray(rgb).save(buffer, "JPEG", exif=exif)
    return buffer.getvalue()
