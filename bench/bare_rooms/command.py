"""`roomfix evaluate-bare-rooms`: white rooms with doors, windows, lamps, sockets and switches, and maybe furniture."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from app.commands.console import progress_bars
from app.engine.progress import Progress
from app.geometry.se3 import Pose
from app.services.resources import cap_threads, open_models
from app.settings import Settings
from bench.evaluation.variations import parse_variations
from bench.figures.shown import FiguresTitle, Shown
from bench.recordings.scan import render_poses
from bench.recordings.trajectory import WING_WALK, camera_pose, query_poses, scan_poses
from bench.render.raycast import FAST
from bench.render.scene import Building
from bench.rooms.compare import ONE_LOOK, OURS, Comparison, RoomResult, compare_room
from bench.rooms.rooms import Room, RoomSplit
from bench.rooms.tables import splits_table

DEFAULT_DIR = Path(".roomfix/bare")
WALK_FRAMES = 300
# Pictures from one place, of a lens that sees 63 degrees.
PANORAMA_STEP_DEG = 30.0
# How far from all panoramas the pictures are taken that are located.
PANORAMA_DISTANCE_M = 0.7
QUERIES_TO_CHOOSE = 5
PIPELINES = (OURS, ONE_LOOK, "plain sift", "plain xfeat-lighterglue")


def evaluate_bare_rooms(
    building: Annotated[
        int, typer.Option(min=1, help="The number of the building: each has other sockets and stains.")
    ] = 1,
    frames: Annotated[int, typer.Option(min=2, help="Frames of the scan of the wing.")] = 200,
    count: Annotated[int, typer.Option(min=1, help="Pictures that are located.")] = 40,
    furnished: Annotated[bool, typer.Option(help="With furniture, but nothing on the walls.")] = False,
    panoramas: Annotated[
        int,
        typer.Option(
            min=0, help="In place of the frames of a walk, pictures all around from this many places."
        ),
    ] = 0,
    features: Annotated[
        list[str] | None, typer.Option(help="Features of the map, sift by default; repeat it for several.")
    ] = None,
    pipeline: Annotated[
        list[str] | None,
        typer.Option(help=f"One of {', '.join(PIPELINES)}; repeat it for several; default all."),
    ] = None,
    data_dir: Annotated[Path, typer.Option(help="Folder for what is rendered.")] = DEFAULT_DIR,
    figures: FiguresTitle = None,
) -> None:
    """Locate rendered pictures of white rooms, in which little can be recognised, in a map of them."""
    cap_threads()
    settings = Settings()
    poses = panorama_poses(panoramas, count, building) if panoramas else bare_poses(frames, count, building)
    frames = len(poses) - count
    made = Building(building, is_bare=True, is_furnished=furnished)
    results: list[RoomResult] = []
    with ThreadPoolExecutor(settings.workers) as executor, progress_bars() as progress:
        name = "-".join(map(str, ("furnished" if furnished else "bare", building, panoramas, frames, count)))
        _render(name, poses, data_dir / name, made, settings.workers, progress)
        wanted = Comparison(pipelines=pipeline or list(PIPELINES), variations=parse_variations([]))
        for each in features or ["sift"]:
            room = Room(name, (RoomSplit("unseen", f"0:{frames}", f"{frames}:"),), {"features": each})
            for result in compare_room(data_dir, room, wanted, open_models(settings), executor, progress):
                results.append(result)
    shown = Shown()
    shown.table(splits_table(results))
    shown.write("evaluate-bare-rooms", figures)


def bare_poses(frames: int, count: int, seed: int) -> list[Pose]:
    """Return the poses of a walk through the wing, and then those of pictures near it."""
    scan = scan_poses(WING_WALK, frames)
    return [*scan, *query_poses(scan, count, seed)]


def panorama_poses(places: int, count: int, seed: int) -> list[Pose]:
    """Return the poses of pictures all around from places along the walk, and then those of pictures between them."""
    walk = scan_poses(WING_WALK, WALK_FRAMES)
    centres = [walk[row].translation for row in np.linspace(0, WALK_FRAMES - 1, places).astype(int)]
    around = [
        camera_pose(centre, float(heading), 0.0, 0.0)
        for centre in centres
        for heading in np.arange(0.0, 2.0 * np.pi, np.radians(PANORAMA_STEP_DEG))
    ]
    near = query_poses(walk, QUERIES_TO_CHOOSE * count, seed)
    apart = [
        pose
        for pose in near
        if min(np.linalg.norm(pose.translation - centre) for centre in centres) > PANORAMA_DISTANCE_M
    ]
    return [*around, *apart[:count]]


def _render(
    name: str, poses: Sequence[Pose], folder: Path, building: Building, workers: int, progress: Progress
) -> None:
    def report(done: int, total: int) -> None:
        progress.report("render", done, total)

    render_poses(name, tuple(poses), folder, workers, report, building, FAST)
