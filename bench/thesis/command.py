"""`roomfix evaluate-thesis`: the monitoring-camera thesis's experiments, by its equations and by the service."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from app.commands.console import progress_bars
from app.engine.anchors.features import AnchorDescriber
from app.services.resources import cap_threads
from bench.anchors.pairs import AnchorPair, PairEvaluator
from bench.anchors.thesis import AnchorPipeline, ThesisEvaluator, thesis_describer
from bench.figures.shown import FiguresTitle, Shown
from bench.thesis.figures import ErrorFigures, error_figures, experiment_table
from bench.thesis.frame_rate import frame_rate_table, measure_frame_rates
from bench.thesis.latency import latency_table, measure_latency
from bench.thesis.pairs import Experiment, PairRenderer

PIPELINES = (AnchorPipeline.THESIS, AnchorPipeline.DEFAULT)
# Pairs of seeds 1 to 4 decided limits of the service.
SEED = 5
TITLES = {
    Experiment.ANGLE: "Angle at the POI, phone 5 m from it",
    Experiment.DISTANCE: "Distance of the phone from the POI, angle 30 degrees",
    Experiment.RESOLUTION: "Pixels of the phone's picture",
    Experiment.PLACE: "Kind of place",
    Experiment.TIME_OF_DAY: "Time of day",
}


class Other(StrEnum):
    """An experiment on more than pairs."""

    FRAME_RATE = "frame-rate"
    LATENCY = "latency"


NAMES = (*Experiment, *Other)


def evaluate_thesis(
    directory: Annotated[Path, typer.Argument(help="Folder for what is rendered.")],
    experiment: Annotated[
        list[str] | None,
        typer.Option(help=f"One of {', '.join(NAMES)}; repeat it for several; default all."),
    ] = None,
    pipeline: Annotated[
        list[AnchorPipeline] | None,
        typer.Option(help="thesis: its equations; default: what the service does; both if not named."),
    ] = None,
    count: Annotated[int, typer.Option(min=1, help="Pairs of each row.")] = 40,
    seed: Annotated[int, typer.Option(help="Which pairs are drawn.")] = SEED,
    workers: Annotated[int, typer.Option(min=1, help="Processes that render.")] = 1,
    figures: FiguresTitle = None,
) -> None:
    """Repeat the monitoring-camera thesis's experiments in the rendered building, by its equations and by ours."""
    cap_threads()
    wanted = _parsed(experiment)
    pipelines = pipeline or list(PIPELINES)
    describers = {AnchorPipeline.THESIS: thesis_describer(), AnchorPipeline.DEFAULT: AnchorDescriber()}
    describers, shown = {name: describers[name] for name in pipelines}, Shown()
    with progress_bars() as progress:
        renderer = PairRenderer(
            directory, count, seed, workers, lambda done, total: progress.report("render", done, total)
        )
        for each in wanted:
            if isinstance(each, Experiment):
                groups = renderer.groups(each)
                rows: dict[tuple[str, str], ErrorFigures] = {}
                for number, (setting, pairs) in enumerate(groups.items()):
                    progress.report(each.value, number, len(groups))
                    for name, describer in describers.items():
                        rows[setting, name.value] = _located(name, describer, pairs)
                progress.report(each.value, len(groups), len(groups))
                shown.table(experiment_table(TITLES[each], rows))
            elif each is Other.LATENCY:
                shown.table(latency_table(measure_latency(renderer.resolutions(), describers)))
            else:
                rates = measure_frame_rates(directory, describers, workers, progress)
                shown.table(frame_rate_table(rates))
    shown.write("evaluate-thesis", figures)


def _parsed(names: Sequence[str] | None) -> list[Experiment | Other]:
    known: dict[str, Experiment | Other] = {each.value: each for each in NAMES}
    unknown = [name for name in names or () if name not in known]
    if unknown:
        raise typer.BadParameter(f"{unknown[0]!r} is none of {', '.join(known)}.", param_hint="--experiment")
    return [known[name] for name in names or known]


def _located(
    pipeline: AnchorPipeline, describer: AnchorDescriber, pairs: Sequence[AnchorPair]
) -> ErrorFigures:
    # An evaluator keeps the features of monitoring frames by the names of pairs, which rows share.
    evaluator = (ThesisEvaluator if pipeline is AnchorPipeline.THESIS else PairEvaluator)(describer)
    return error_figures([evaluator.evaluate(pair) for pair in pairs])
