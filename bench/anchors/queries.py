"""Many anchors in one venue: which one a phone's picture is matched with first, and how long a query takes."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from app.engine.anchors.features import AnchorDescriber
from app.engine.anchors.locator import OPTIONS, ranked
from app.engine.anchors.matching import likeness
from app.services.anchor_locator import AnchorLocator
from app.services.anchors import AnchorService
from app.services.floor_features import FeatureLibrary
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.storage.floors import put_floor
from app.storage.venues import create_venue
from app.vision.images import Rgb, decode_image
from bench.anchors.pairs import AnchorPair, PairEvaluator

VENUE = "evaluation"


@dataclass(frozen=True, slots=True)
class QueryTimes:
    """Medians by stage in milliseconds; `akaze_share`, what A-KAZE extraction takes of the whole."""

    queries: int
    located: int
    stages_ms: dict[str, float]
    total_ms: float
    akaze_share: float


@dataclass(frozen=True, slots=True)
class QueryLap:
    """One query's milliseconds by stage, and those that the processor worked for it."""

    stages_ms: Mapping[str, float]
    processor_ms: float


@dataclass(frozen=True, slots=True)
class QueryLaps:
    """The times of queries, without the first one, which opens what the others find open, and how many were located."""

    located: int
    laps: tuple[QueryLap, ...]


@dataclass(frozen=True, slots=True)
class FirstChoices:
    """Of how many phones a right anchor comes first: by visual words, and after looking at matches."""

    asked: int
    by_words: int
    by_matches: int


def choose_first(evaluator: PairEvaluator, pairs: Sequence[AnchorPair], anchors: int = 20) -> FirstChoices:
    """Return how often the first of `anchors` is a right one: it has a POI that the phone sees."""
    by_words = by_matches = asked = 0
    for start in range(0, len(pairs) - anchors + 1, anchors):
        group = pairs[start : start + anchors]
        monitors = [evaluator.monitor_features(pair) for pair in group]
        for pair in group:
            phone = evaluator.phone_features(pair.phone(), pair.gravity_in_phone)
            words = evaluator.alike_by_words(monitors, phone)
            right = [not pair.seen.isdisjoint(poi.id for poi in other.spec.pois) for other in group]
            by_words += right[int(np.argmax(words))]
            first = np.argsort(-words, kind="stable")[: OPTIONS.candidates]
            by_matches += right[first[ranked([likeness(monitors[row], phone) for row in first])[0]]]
            asked += 1
    return FirstChoices(asked, by_words, by_matches)


def time_queries(resources: Resources, describer: AnchorDescriber, pairs: Sequence[AnchorPair]) -> QueryTimes:
    """Return the medians of `measure_laps`."""
    measured = measure_laps(resources, describer, pairs)
    laps = [lap.stages_ms for lap in measured.laps]
    stages = {name: round(float(np.median([lap.get(name, 0.0) for lap in laps])), 1) for name in laps[0]}
    total = float(np.median([sum(lap.values()) for lap in laps]))
    shares = [lap.get("akaze", 0.0) / sum(lap.values()) for lap in laps]
    return QueryTimes(
        len(pairs), measured.located, stages, round(total, 1), round(float(np.median(shares)), 3)
    )


def measure_laps(resources: Resources, describer: AnchorDescriber, pairs: Sequence[AnchorPair]) -> QueryLaps:
    """Put all pairs' anchors into one venue, push their frames, and locate each phone, through the service."""
    service = AnchorService(resources, MapLibrary(resources), describer)
    with resources.database.write() as connection:
        create_venue(connection, VENUE, "Evaluation")
        for floor in sorted({pair.spec.floor_id for pair in pairs}):
            put_floor(
                connection, VENUE, floor, name=floor, level=0, z_min_m=-1e3, z_max_m=1e3, plan_from_world=None,
                plan_residual_m=None,
            )  # fmt: skip
    for pair in pairs:
        service.put(pair.name, replace(pair.spec, venue_id=VENUE))
        service.push(pair.name, _jpeg(pair.monitor()))
    locator = AnchorLocator(resources, describer, FeatureLibrary(resources.database))
    laps: list[QueryLap] = []
    located = 0
    for pair in pairs:
        rgb = decode_image(_jpeg(pair.phone()))
        started = time.process_time()
        found = locator.locate(VENUE, None, rgb, pair.phone_camera, pair.gravity_in_phone.tolist())
        located += found.plan_from_phone is not None
        laps.append(QueryLap(found.timings_ms, 1e3 * (time.process_time() - started)))
    return QueryLaps(located, tuple(laps[1:]))


def _jpeg(rgb: Rgb) -> bytes:
    _, data = cv2.imencode(".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 92])
    return data.tobytes()
