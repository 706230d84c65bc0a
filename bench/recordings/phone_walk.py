"""A walk through the demonstration venue as a phone's camera films it: a video for a browser's fake camera.

`python -m bench.recordings.phone_walk DIRECTORY` renders it. Chromium shows it to a page as a camera with
`--use-fake-device-for-media-stream --use-file-for-fake-video-capture=DIRECTORY/walk.y4m`.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from app.geometry.se3 import Pose
from bench.recordings.cache import make_directory
from bench.recordings.queries import PHONE_CAMERA
from bench.recordings.trajectory import STEP_M, Stop, Walk, camera_pose, smooth_path
from bench.render.frames import FrameJob, Progress, make_frames
from bench.render.noise import seeded
from bench.render.scene import SCENE_VERSION
from bench.render.sensor import ColourSensor

FPS = 10
# From the landmark Reception past Gallery A to the landmark Gallery B, in world metres.
WALK = Walk(0, (Stop(4.75, 4.55), Stop(4.55, 12.45), Stop(4.95, 21.45)))
DESTINATION = "Gallery B"
SPEED_M_S = 0.8
TURN_DEG_S = 40.0
EYE_HEIGHT_M = 1.5
# The walker stands before and after the walk.
STAND_S = 2.0
BOB_M = 0.015
SWAY_DEG = 1.0

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PhoneWalk:
    """The video, its frames, and the true pose of each."""

    video: Path
    frames: tuple[Path, ...]
    world_from_camera: tuple[Pose, ...]


def render_phone_walk(directory: Path, *, workers: int = 1, progress: Progress | None = None) -> PhoneWalk:
    """Render the walk into `directory`, or return at once when it is there.

    Raises `InvalidInputError` when the directory holds something else.
    """
    poses = walk_poses()
    frames = tuple(directory / "frames" / f"{k:04d}.jpg" for k in range(len(poses)))

    def fill(partial: Path) -> None:
        (partial / "frames").mkdir(exist_ok=True)
        jobs = [
            FrameJob(
                camera=PHONE_CAMERA,
                world_from_camera=pose,
                colour_path=partial / "frames" / path.name,
                depth_path=None,
                seed=("phone walk", k),
                sensor=ColourSensor(),
            )
            for k, (pose, path) in enumerate(zip(poses, frames, strict=True))
        ]
        make_frames(partial, jobs, workers, progress)
        write_video(partial / "walk.y4m", [job.colour_path for job in jobs])
        truth = [{"position": list(pose.translation), "quaternion": list(pose.quaternion)} for pose in poses]
        (partial / "poses.json").write_text(json.dumps(truth, default=float), encoding="utf-8")

    recipe = {"phone_walk": len(poses), "version": SCENE_VERSION}
    make_directory(directory, recipe, fill)
    return PhoneWalk(directory / "walk.y4m", frames, tuple(poses))


def walk_poses() -> list[Pose]:
    """Return world_from_camera of each frame: the phone is held upright, ahead, by a hand that is not quite still."""
    points, headings = _way()
    moved = np.linalg.norm(np.diff(points[:, :2], axis=0), axis=1) / SPEED_M_S
    turned = np.abs(np.degrees(np.diff(headings))) / TURN_DEG_S
    at_s = np.concatenate([[0.0], np.cumsum(np.maximum(moved, turned))]) + STAND_S
    times_s = np.arange(0.0, at_s[-1] + STAND_S, 1 / FPS)
    places = np.column_stack([np.interp(times_s, at_s, points[:, k]) for k in range(3)])
    heading = np.interp(times_s, at_s, headings)
    rng = seeded("phone walk hand", 0, len(times_s))
    hand = gaussian_filter1d(rng.standard_normal((len(times_s), 4)), 3, axis=0, mode="wrap") * 3.2
    places[:, 2] += EYE_HEIGHT_M + BOB_M * hand[:, 0]
    yaw, pitch, roll = np.radians(SWAY_DEG * hand[:, 1:]).T
    return [
        camera_pose(place, angle, tilt, bank)
        for place, angle, tilt, bank in zip(places, heading + yaw, pitch - np.radians(2), roll, strict=True)
    ]


def write_video(path: Path, frames: list[Path]) -> None:
    """Write pictures as YUV4MPEG2 (4:2:0), which a browser's fake camera plays again and again."""
    with path.open("wb") as file:
        for k, frame in enumerate(frames):
            picture = np.asarray(cv2.imread(str(frame)), np.uint8)
            if k == 0:
                height, width = picture.shape[:2]
                file.write(f"YUV4MPEG2 W{width} H{height} F{FPS}:1 Ip A1:1 C420jpeg\n".encode())
            file.write(b"FRAME\n" + cv2.cvtColor(picture, cv2.COLOR_BGR2YUV_I420).tobytes())


def _way() -> tuple[Floats, Floats]:
    """Return the ground under the way every 2 cm (n, 3), and the directions of walking (n,) in radians."""
    points, _ = smooth_path(WALK)
    ahead = gaussian_filter1d(np.gradient(points[:, :2], axis=0), 0.5 / STEP_M, axis=0, mode="nearest")
    return points, np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))


if __name__ == "__main__":
    made = render_phone_walk(Path(sys.argv[1]), progress=lambda done, total: print(f"{done} of {total}"))
    print(made.video)
