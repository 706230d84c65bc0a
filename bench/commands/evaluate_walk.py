"""`roomfix evaluate-walk`: a corridor mapped from a walk without poses, by uniform motion."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Table

from app.commands.console import progress_bars
from app.engine.mapping.build_map import build_map
from app.engine.mapping.options import parse_build_options
from app.engine.mapping.self_check import check_map
from app.engine.query.localizer import Localizer
from app.importers.registry import open_scan
from app.services.resources import cap_threads, open_models
from app.settings import Settings
from app.vision.images import decode_image
from bench.commands.demo import DEFAULT_DIR
from bench.figures.shown import FiguresTitle, Shown


def evaluate_walk(
    data_dir: Annotated[Path, typer.Option(help="The folder of `roomfix demo`.")] = DEFAULT_DIR,
    options: Annotated[str, typer.Option(help="JSON, as in POST /database/build.")] = "{}",
    json_file: Annotated[Path | None, typer.Option("--json", help="Write all figures to this file.")] = None,
    figures_title: FiguresTitle = None,
) -> None:
    """Render a walk down a corridor, build its map by uniform motion, and locate pictures taken between its frames."""
    from bench.recordings.straight_walk import render_walk

    cap_threads()
    settings = Settings()
    models = open_models(settings)
    with ThreadPoolExecutor(settings.workers) as executor, progress_bars() as progress:
        walk = render_walk(
            data_dir / "walk", progress=lambda done, total: progress.report("render", done, total)
        )
        motion = walk.motion
        stated = {
            "start": list(motion.start),
            "speed_m_s": motion.speed_m_s,
            "direction_deg": motion.direction_deg,
            "fps": motion.fps,
        }
        parsed = parse_build_options({**json.loads(options), **stated})
        source = open_scan(walk.scan.directory, parsed.format, parsed.scan)
        built = build_map(source, parsed, models, executor, progress)
        check_map(built, source, models, executor, progress)
        localizer = Localizer.of(built.artifact, built.index, models)
        offsets = []
        for path, truth in zip(walk.queries, walk.world_from_query, strict=True):
            found = localizer.localize(decode_image(path.read_bytes()), walk.scan.camera).world_from_camera
            if found is not None:
                offsets.append(found.translation - truth.translation)
    figures = _figures(np.array(offsets).reshape(-1, 3), motion.direction_deg, len(walk.queries))
    figures["keyframes"] = built.artifact.keyframe_count
    table = Table("walk by uniform motion", "")
    for name, value in figures.items():
        table.add_row(name, str(value))
    shown = Shown()
    shown.table(table)
    shown.write("evaluate-walk", figures_title)
    if json_file is not None:
        json_file.write_text(json.dumps(figures, indent=1))


def _figures(
    offsets: np.ndarray[tuple[int, int], np.dtype[np.float64]], direction_deg: float, queries: int
) -> dict[str, float]:
    """Return the figures of errors (n, 3) in metres, along the walk and in all."""
    direction = np.radians(direction_deg)
    along = np.abs(offsets @ [np.cos(direction), np.sin(direction), 0.0])
    whole = np.linalg.norm(offsets, axis=1)
    return {
        "pictures": queries,
        "located": len(offsets),
        "along the corridor, median m": round(float(np.median(along)), 3) if len(along) else float("nan"),
        "along the corridor, largest m": round(float(along.max(initial=0.0)), 3),
        "position, median m": round(float(np.median(whole)), 3) if len(along) else float("nan"),
        "position, largest m": round(float(whole.max(initial=0.0)), 3),
    }
