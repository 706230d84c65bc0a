"""A walk straight down a corridor at an even speed, recorded without poses, and pictures taken between its frames."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d

from app.geometry.se3 import Pose
from app.geometry.uniform_motion import UniformMotion
from bench.recordings.cache import make_directory
from bench.recordings.scan import SCAN_CAMERA, START_S, DemoScan, frame_jobs, write_lists
from bench.recordings.trajectory import SCAN_HEIGHT_M, camera_pose
from bench.render.frames import FrameJob, Progress, make_frames
from bench.render.noise import seeded
from bench.render.scene import SCENE_VERSION
from bench.render.sensor import DEPTH_SCALE, ColourSensor

# Down the middle of the ground floor's south corridor, at an easy pace.
WALK = UniformMotion(start=(25.6, 6.2, SCAN_HEIGHT_M), speed_m_s=0.8, direction_deg=0.0, fps=5.0)
WALK_FRAMES = 80
# The hand that carries the camera moves it up and down; the stated motion doesn't have that.
BOB_M = 0.01
# It also turns the camera a little.
SWAY_DEG = 0.5


@dataclass(frozen=True, slots=True)
class DemoWalk:
    """A scan in TUM layout without `groundtruth.txt`, the motion to state for it, and pictures to locate."""

    scan: DemoScan
    motion: UniformMotion
    queries: tuple[Path, ...]
    world_from_query: tuple[Pose, ...]


def render_walk(
    directory: Path, *, frames: int = WALK_FRAMES, workers: int = 2, progress: Progress | None = None
) -> DemoWalk:
    """Render the walk below `directory`, in `scan` and `queries`, or return at once when it is there.

    A picture is taken half-way between every fourth frame and the next. Raises `InvalidInputError` when the
    directory holds something else.
    """
    steps = np.arange(frames, dtype=np.float64)
    between = np.arange(1.5, frames - 1, 4.0)
    poses, query_poses = _poses(steps, 0), _poses(between, 1)
    times = tuple(START_S + float(step) / WALK.fps for step in steps)
    scan = DemoScan(directory / "scan", SCAN_CAMERA, DEPTH_SCALE, times, tuple(poses))
    queries = tuple(directory / "queries" / f"query_{k:04d}.jpg" for k in range(len(between)))

    def fill(partial: Path) -> None:
        part = DemoScan(partial / "scan", SCAN_CAMERA, DEPTH_SCALE, times, tuple(poses))
        for folder in (part.directory / "rgb", part.directory / "depth", partial / "queries"):
            folder.mkdir(parents=True, exist_ok=True)
        jobs = frame_jobs(part, "walk")
        jobs += [
            FrameJob(
                camera=SCAN_CAMERA,
                world_from_camera=pose,
                colour_path=partial / "queries" / path.name,
                depth_path=None,
                seed=("walk query", k),
                sensor=ColourSensor(),
            )
            for k, (pose, path) in enumerate(zip(query_poses, queries, strict=True))
        ]
        make_frames(partial, jobs, workers, progress)
        write_lists(part)
        (part.directory / "groundtruth.txt").unlink()

    make_directory(directory, {"scan": "walk", "frames": frames, "version": SCENE_VERSION}, fill)
    return DemoWalk(scan, WALK, queries, tuple(query_poses))


def _poses(steps: np.ndarray[tuple[int], np.dtype[np.float64]], seed: int) -> list[Pose]:
    """Return world_from_camera at steps of the walk, whole ones or between, held by a hand."""
    rng = seeded("walk hand", seed, len(steps))
    hand = gaussian_filter1d(rng.standard_normal((len(steps), 4)), 1.5, axis=0, mode="wrap") * 2.3
    along = np.array([np.cos(np.radians(WALK.direction_deg)), np.sin(np.radians(WALK.direction_deg)), 0.0])
    found = []
    for step, (bob, *turns) in zip(steps, hand, strict=True):
        place = np.array(WALK.start) + WALK.speed_m_s * float(step) / WALK.fps * along
        yaw, pitch, roll = np.radians(SWAY_DEG * np.array(turns))
        heading = np.radians(WALK.direction_deg) + yaw
        found.append(camera_pose(place + np.array([0.0, 0.0, BOB_M * bob]), heading, pitch, roll))
    return found
