"""`roomfix calibrate`: the keyframe thresholds of a scan."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from app.commands.console import console, progress_bars
from app.engine.mapping.calibrate import calibrate as run_calibration
from app.engine.mapping.calibration_curves import Calibration, FittedCurve
from app.engine.mapping.keyframe_rule import check_wanted_matches
from app.engine.mapping.options import parse_build_options
from app.errors import InvalidInputError
from app.importers.registry import open_scan
from app.services.resources import cap_threads, open_models
from app.settings import Settings
from app.vision.keyframes import ATTITUDE_CURVE, POSITION_CURVE, PowerLaw


def calibrate(
    dataset: Annotated[Path, typer.Argument(exists=True, file_okay=False, help="A scan in a known format.")],
    options: Annotated[str, typer.Option(help="JSON, as in POST /database/build.")] = "{}",
    matches: Annotated[
        float | None, typer.Option(help="Matches that a keyframe must share with what is near it; 50.")
    ] = None,
    seed: Annotated[int, typer.Option(help="For the choice of frames and pairs.")] = 0,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write all figures to this file.")] = None,
) -> None:
    """Fit matches over pose difference to a scan, and derive the keyframe thresholds that suit it."""
    cap_threads()
    parsed = parse_build_options(_json(options))
    wanted = None if matches is None else check_wanted_matches(matches)
    source = open_scan(dataset, parsed.format, parsed.scan)
    settings = Settings()
    with ThreadPoolExecutor(settings.workers) as executor, progress_bars() as progress:
        found = run_calibration(source, parsed, open_models(settings), executor, progress, wanted, seed)
    console.print(_table(found))
    for warning in found.warnings:
        console.print(f"[yellow]{warning}[/yellow]")
    if json_file is not None:
        json_file.write_text(json.dumps(found.as_dict(), indent=1))


def _json(text: str) -> object:
    try:
        return json.loads(text)
    except ValueError as error:
        raise InvalidInputError(f"options is not JSON: {error}.") from None


def _table(found: Calibration) -> Table:
    table = Table(
        "",
        "position",
        "attitude",
        title=f"{found.frames} frames, {found.features}, {found.wanted_matches:g} matches",
    )
    curves = found.position, found.attitude
    for name, row in (
        ("a", [f"{curve.curve.a:.4g}" for curve in curves]),
        ("b", [f"{curve.curve.b:.4g}" for curve in curves]),
        ("fitted between", [f"{curve.range[0]:.3f} and {curve.range[1]:.3f}" for curve in curves]),
        ("pairs of the fit, held back", [f"{curve.pairs_fit}, {curve.pairs_validation}" for curve in curves]),
        ("RMSE of fit (matches)", [f"{curve.rmse_fit:.1f}" for curve in curves]),
        ("RMSE of validation", [_or_dash(curve.rmse_validation) for curve in curves]),
        (
            "other difference up to",
            [f"{found.position.other_limit:.3f} rad", f"{found.attitude.other_limit:.3f} m"],
        ),
        ("held-back median at threshold", [_or_dash(curve.left_at_threshold) for curve in curves]),
        ("threshold", _thresholds(*curves)),
        ("paper's a, b", [f"{curve.a:g}, {curve.b:g}" for curve in (POSITION_CURVE, ATTITUDE_CURVE)]),
        ("paper's threshold", _paper_thresholds(POSITION_CURVE, ATTITUDE_CURVE, found.wanted_matches)),
    ):
        table.add_row(name, *row, end_section=name == "threshold")
    return table


def _thresholds(position: FittedCurve, attitude: FittedCurve) -> list[str]:
    return [f"{position.threshold:.4f} m", f"{attitude.threshold:.4f} rad"]


def _paper_thresholds(position: PowerLaw, attitude: PowerLaw, wanted: float) -> list[str]:
    return [f"{position.inverse(wanted):.4f} m", f"{attitude.inverse(wanted):.4f} rad"]


def _or_dash(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"
