"""The command line: the same functions as the endpoints."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import typer

from app.commands import (
    build,
    calibrate,
    demo,
    evaluate,
    evaluate_anchors,
    evaluate_demo,
    evaluate_extend,
    evaluate_phones,
    evaluate_walk,
    fit_confidence,
    import_plan,
    keyframes,
    push_frames,
    reliability,
    serve,
    simulate,
    simulate_figures,
    stream,
    track,
    track_anchors,
)
from app.commands.console import errors
from app.errors import RoomfixError

app = typer.Typer(
    no_args_is_help=True, add_completion=False, help="Roomfix: tells a camera where it is inside a building."
)
COMMANDS: tuple[Callable[..., Any], ...] = (
    serve.serve, serve.worker, build.build, build.locate, build.sweep,
    evaluate.evaluate, evaluate.benchmark, calibrate.calibrate, demo.demo, evaluate_demo.evaluate_demo,
    reliability.reliability,
    evaluate_extend.evaluate_extend, evaluate_phones.evaluate_phones,
    import_plan.import_plan,
    evaluate_walk.evaluate_walk, keyframes.keyframes,
    evaluate_anchors.evaluate_anchors, push_frames.push_frames,
    track.track, track_anchors.track_anchors, stream.stream, stream.stream_bench, simulate.simulate,
    simulate_figures.simulate_figures,
)  # fmt: skip
for command in COMMANDS:
    app.command()(command)
app.command("fit-confidence")(fit_confidence.fit_confidence_command)


def main() -> None:
    """Run a command; an error that the user can act on is one line, not a traceback."""
    try:
        app()
    except RoomfixError as error:
        errors.print(f"[red]Error:[/red] {error}")
        sys.exit(1)


if __name__ == "__main__":
    main()
