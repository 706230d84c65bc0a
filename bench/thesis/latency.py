"""How long a fix takes by stage, mean and standard deviation, at two resolutions, on one thread (C figure 6.12)."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.table import Table

from app.commands.console import settings_from
from app.engine.anchors.features import AnchorDescriber
from app.engine.stage_timer import StageTimer
from app.services.resources import Resources
from bench.anchors.pairs import AnchorPair
from bench.anchors.queries import measure_laps
from bench.anchors.thesis import AnchorPipeline, ThesisEvaluator
from bench.baselines.thesis_anchor import describe_phone, locate_by_thesis, most_similar

# Phones that are located, each beside all their monitoring cameras.
CAMERAS = 20
TOTAL = "total"
PROCESSOR = "total, processor time"


@dataclass(frozen=True, slots=True)
class StageTime:
    """Mean and standard deviation of a stage's milliseconds over the phones."""

    mean_ms: float
    deviation_ms: float


# Pipeline -> setting -> stage -> time.
Times = Mapping[str, Mapping[str, Mapping[str, StageTime]]]


def measure_latency(
    groups: Mapping[str, Sequence[AnchorPair]], describers: Mapping[AnchorPipeline, AnchorDescriber]
) -> Times:
    """Return the times of the pipelines by the groups' names; each phone is located beside 20 monitoring cameras."""
    measured: dict[str, dict[str, dict[str, StageTime]]] = {}
    for pipeline, describer in describers.items():
        laps_of = _thesis_laps if pipeline is AnchorPipeline.THESIS else _service_laps
        measured[pipeline.value] = {
            name: _summarized(laps_of(describer, pairs[:CAMERAS])) for name, pairs in groups.items()
        }
    return measured


def latency_table(times: Times) -> Table:
    """Return the table of the times: a row for each stage of each pipeline, mean and deviation at each setting."""
    settings = list(next(iter(times.values())))
    columns = [f"{name}, {what} ms" for name in settings for what in ("mean", "deviation")]
    table = Table(
        "pipeline", "stage", *columns, title=f"A fix beside {CAMERAS} monitoring cameras, one thread"
    )
    for pipeline, by_setting in times.items():
        for stage in dict.fromkeys(stage for stages in by_setting.values() for stage in stages):
            found = [by_setting[name].get(stage) for name in settings]
            cells = [
                "-" if each is None else f"{value:.1f}"
                for each in found
                for value in ((0.0, 0.0) if each is None else (each.mean_ms, each.deviation_ms))
            ]
            table.add_row(pipeline, stage, *cells)
    return table


def _summarized(laps: Sequence[Mapping[str, float]]) -> dict[str, StageTime]:
    stages = dict.fromkeys(stage for lap in laps for stage in lap)
    values = {stage: np.array([lap.get(stage, 0.0) for lap in laps]) for stage in stages}
    return {stage: StageTime(float(of.mean()), float(of.std())) for stage, of in values.items()}


def _service_laps(describer: AnchorDescriber, pairs: Sequence[AnchorPair]) -> list[dict[str, float]]:
    with tempfile.TemporaryDirectory() as scratch:
        resources = Resources.open(settings_from(data_dir=Path(scratch)))
        try:
            laps = measure_laps(resources, describer, pairs).laps
        finally:
            resources.close()
    return [_with_totals(dict(lap.stages_ms), lap.processor_ms) for lap in laps]


def _thesis_laps(describer: AnchorDescriber, pairs: Sequence[AnchorPair]) -> list[dict[str, float]]:
    """Return the stages of C chapter 4: the phone's features, the camera by its bag of words, the place."""
    evaluator = ThesisEvaluator(describer)
    monitors = [evaluator.monitor_view(pair) for pair in pairs]
    laps = []
    for pair in pairs:
        rgb, started, timer = pair.phone(), time.process_time(), StageTimer()
        phone = describe_phone(describer, rgb)
        timer.lap("akaze")
        monitor = most_similar(describer, monitors, phone)
        timer.lap("bag of words")
        locate_by_thesis(monitor, phone, pair.phone_camera, pair.gravity_in_phone)
        timer.lap("matches and place")
        laps.append(_with_totals(timer.milliseconds, 1e3 * (time.process_time() - started)))
    # The first one opens what the others find open.
    return laps[1:]


def _with_totals(stages_ms: dict[str, float], processor_ms: float) -> dict[str, float]:
    return {**stages_ms, TOTAL: sum(stages_ms.values()), PROCESSOR: processor_ms}
