"""Queries whose stated camera is wrong, as apps send them: turned, cut, of another size, zoomed."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike

from app.engine.mapping.frame_images import frame_rgb
from app.engine.query.localizer import Localizer
from app.engine.query.stated_camera import stated_camera
from app.errors import InvalidCameraError
from app.geometry.camera import Camera
from app.geometry.camera_hint import CameraHint
from app.geometry.se3 import Pose
from app.geometry.turns import camera_from_turned
from app.vision.images import Rgb
from bench.evaluation.dataset import Split
from bench.evaluation.outcome import outcome_of
from bench.evaluation.pose_errors import QueryOutcome, pose_error

# Digital zooms that are stated as none.
ZOOMS = (1.1, 1.25, 1.5, 2.0)
# A zoom whose middle is not the principal point, as stabilisation moves it: by how much of the picture's width.
ASIDE = "zoom 1.25 aside"
ASIDE_ZOOM = 1.25
ASIDE_SHARE = 0.05
# Directions of one query after the other, so that all are met: a golden angle.
ASIDE_TURN_RAD = 2.4
# What the numbers alone can show, and no mistake to compare with.
BY_NUMBERS = ("right", "landscape numbers, portrait", "cut to 16:9", "half the size")
# How many times too long fy is stated: numbers of a picture of another shape, scaled for each axis by itself.
STRETCHES = {"fy 10 % too long": 1.1, "fy a third too long": 4 / 3}
# A sure answer, as the bar for wrong ones has it.
SURE_CONFIDENCE = 0.9
SURE_SIGMAS = 3.0


@dataclass(frozen=True, slots=True)
class StatedQuery:
    """A picture, what is stated of its camera, and its true pose."""

    name: str
    rgb: Rgb
    hint: CameraHint
    world_from_camera: Pose


@dataclass(slots=True, kw_only=True)
class CameraFigures:
    """What became of queries with one mistake in their camera."""

    mistake: str
    queries: int = 0
    refused: int = 0
    located: int = 0
    refined: int = 0
    surely_wrong: int = 0
    errors_m: list[float] = field(default_factory=list)
    outcomes: list[QueryOutcome] = field(default_factory=list)

    def as_row(self) -> list[str]:
        """Return the figures as a row of a table."""
        errors = self.errors_m
        median = f"{100 * float(np.median(errors)):.1f}" if errors else "-"
        largest = f"{100 * max(errors):.1f}" if errors else "-"
        counts = (self.queries, self.refused, self.located, self.refined, self.surely_wrong)
        return [self.mistake, *map(str, counts), median, largest]

    def as_dict(self, name: str, features: str) -> dict[str, Any]:
        """Return the outcomes for JSON, as those of an evaluation of this name."""
        outcomes = [outcome.as_dict() for outcome in self.outcomes]
        return {"name": name, "features": features, "variation": self.mistake, "outcomes": outcomes}


HEADER = (
    "camera",
    "queries",
    "refused (422)",
    "located",
    "of these refined",
    "off by over three sigmas at 0.9 or more",
    "median error cm",
    "largest cm",
)


def evaluate_cameras(localizer: Localizer, split: Split, world_from_scan: Pose) -> list[CameraFigures]:
    """Ask the same pictures with each mistake in their camera, of a map at `world_from_scan`."""
    figures = []
    for mistake in (*BY_NUMBERS, *STRETCHES, *(f"zoom {zoom:g}" for zoom in ZOOMS), ASIDE):
        found = CameraFigures(mistake=mistake)
        for query in _queries(split, mistake, world_from_scan):
            _count(localizer, query, found)
        figures.append(found)
    return figures


def _queries(split: Split, mistake: str, world_from_scan: Pose) -> Iterator[StatedQuery]:
    camera = split.database.camera
    stated = camera.params[: {"PINHOLE": 4, "OPENCV": 8}.get(camera.model, 9)]
    for number, frame in enumerate(split.queries):
        rgb, pose = frame_rgb(split.database, frame), world_from_scan @ frame.scan_from_camera
        if mistake == ASIDE:
            towards = np.array([np.cos(ASIDE_TURN_RAD * number), np.sin(ASIDE_TURN_RAD * number)])
            rgb = _zoomed(rgb, ASIDE_ZOOM, camera, ASIDE_SHARE * camera.width * towards)
        elif mistake.startswith("zoom"):
            rgb = _zoomed(rgb, float(mistake.split()[1]), camera)
        elif mistake.startswith("landscape"):
            rgb, pose = np.ascontiguousarray(np.rot90(rgb)), pose @ camera_from_turned(1)
        elif mistake.startswith("cut"):
            height = round(rgb.shape[1] * 9 / 16)
            top = (rgb.shape[0] - height) // 2
            rgb = np.ascontiguousarray(rgb[top : top + height])
        elif mistake.startswith("half"):
            rgb = np.ascontiguousarray(cv2.resize(rgb, None, fx=2.0, fy=2.0))
        values = CameraHint(values=(stated[0], stated[1] * STRETCHES.get(mistake, 1.0), *stated[2:]))
        yield StatedQuery(frame.name, rgb, values, pose)


def _zoomed(rgb: Rgb, zoom: float, camera: Camera, shift_px: ArrayLike = (0.0, 0.0)) -> Rgb:
    """Return a picture enlarged around its principal point and shifted by (2,), at its own size."""
    moved_px = (1.0 - zoom) * np.array(camera.principal_point_px) + np.asarray(shift_px)
    warp = np.array([[zoom, 0.0, moved_px[0]], [0.0, zoom, moved_px[1]]])
    height, width = rgb.shape[:2]
    return np.asarray(cv2.warpAffine(rgb, warp, (width, height), borderMode=cv2.BORDER_REPLICATE), np.uint8)


def _count(localizer: Localizer, query: StatedQuery, found: CameraFigures) -> None:
    height, width = query.rgb.shape[:2]
    found.queries += 1
    try:
        camera = stated_camera(query.hint, width, height, 0).camera
    except InvalidCameraError:
        found.refused += 1
        return
    started = time.perf_counter()
    answer = localizer.localize(query.rgb, camera)
    milliseconds = 1e3 * (time.perf_counter() - started)
    found.outcomes.append(outcome_of(query.name, answer, query.world_from_camera, milliseconds))
    if answer.world_from_camera is None or answer.accuracy is None:
        return
    error_m, _ = pose_error(answer.world_from_camera, query.world_from_camera)
    found.located += 1
    found.refined += answer.is_refined
    is_sure = answer.confidence >= SURE_CONFIDENCE
    found.surely_wrong += is_sure and error_m > SURE_SIGMAS * answer.accuracy.position_m
    found.errors_m.append(error_m)
