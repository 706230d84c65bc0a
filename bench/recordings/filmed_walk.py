"""A few seconds of a walk through the hall, filmed as smoothly as a phone films, and the monitoring cameras there."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from bench.recordings.cache import make_directory
from bench.recordings.monitor_views import looking
from bench.recordings.scan import START_S, DemoScan, frame_jobs, write_lists
from bench.recordings.trajectory import SCAN_HEIGHT_M, camera_pose
from bench.render.frames import Progress, make_frames
from bench.render.noise import seeded
from bench.render.scene import SCENE_VERSION
from bench.render.sensor import DEPTH_SCALE

Floats = NDArray[np.float64]

FPS = 60.0
SECONDS = 4.0
SPEED_M_S = 0.8
# Through the ground floor's hall, towards the pictures on its north wall.
START_M = np.array([16.7, 9.4])
HEADING_DEG = 80.0
# A hand moves the phone by this much, and turns it; over about the time of a step.
BOB_M = 0.015
SWAY_DEG = 1.0
STEP_S = 0.12
# Where monitoring cameras hang, and which point of the north wall each looks at.
CAMERAS_M = ((14.6, 9.2), (15.6, 9.4), (17.4, 9.3), (18.6, 9.8), (15.2, 10.6), (18.0, 11.2))
CAMERA_HEIGHT_M = 2.3
WALL_M = np.array([16.8, 16.9, 1.5])
# Raise it whenever a change makes the frames differ.
VERSION = 1


@dataclass(frozen=True, slots=True)
class FilmedWalk:
    """A scan in TUM layout: its first `cameras` frames are those of monitoring cameras, the others the walk."""

    scan: DemoScan
    cameras: int


def render_filmed_walk(
    directory: Path, camera: Camera, *, workers: int = 1, progress: Progress | None = None
) -> FilmedWalk:
    """Render the walk, or return at once when it is there.

    Raises `InvalidInputError` when the directory holds something else.
    """
    poses = (*_camera_poses(), *_walk_poses())
    times = tuple(START_S + k / FPS for k in range(len(poses)))
    scan = DemoScan(directory, camera, DEPTH_SCALE, times, poses)

    def fill(partial: Path) -> None:
        part = DemoScan(partial, camera, DEPTH_SCALE, times, poses)
        for folder in ("rgb", "depth"):
            (partial / folder).mkdir(exist_ok=True)
        jobs = frame_jobs(part, "filmed walk")
        make_frames(partial, jobs, workers, progress)
        write_lists(part)

    size = [camera.width, camera.height, *camera.params]
    make_directory(
        directory, {"scan": "filmed walk", "version": [SCENE_VERSION, VERSION], "camera": size}, fill
    )
    return FilmedWalk(scan, len(CAMERAS_M))


def _camera_poses() -> list[Pose]:
    return [looking(np.array([*place, CAMERA_HEIGHT_M]), WALL_M) for place in CAMERAS_M]


def _walk_poses() -> list[Pose]:
    frames = round(FPS * SECONDS)
    hand = _unsteady(frames)
    along = np.array([np.cos(np.radians(HEADING_DEG)), np.sin(np.radians(HEADING_DEG))])
    poses = []
    for k in range(frames):
        place = np.array([*(START_M + SPEED_M_S * k / FPS * along), SCAN_HEIGHT_M + BOB_M * hand[k, 0]])
        yaw, pitch, roll = np.radians(SWAY_DEG * hand[k, 1:])
        poses.append(camera_pose(place, np.radians(HEADING_DEG) + float(yaw), float(pitch), float(roll)))
    return poses


def _unsteady(frames: int) -> Floats:
    """Return four smooth motions (frames, 4) of unit deviation."""
    noise = seeded("filming hand", 0, frames).standard_normal((frames, 4))
    smooth = gaussian_filter1d(noise, STEP_S * FPS, axis=0, mode="wrap")
    return np.asarray(smooth / smooth.std(axis=0))
