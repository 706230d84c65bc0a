"""A walk of four minutes through a floor, filmed, that begins at a printed marker, and phone pictures near it.

`python -m bench.recordings.floor_video DIRECTORY [FLOOR]` renders it; one that was stopped goes on where it was.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d

from app.geometry.se3 import Pose
from bench.recordings.cache import make_directory
from bench.recordings.queries import DemoQuery, render_queries_near
from bench.recordings.scan import SCAN_CAMERA
from bench.recordings.trajectory import SCAN_HEIGHT_M, Walk, camera_pose, scan_poses, stops_of
from bench.render.frames import FrameJob, Progress, make_frames
from bench.render.noise import seeded
from bench.render.raycast import FAST
from bench.render.scene import DEMONSTRATION, SCENE_VERSION, Building
from bench.render.sensor import ColourSensor
from bench.render.sheet import MarkerSheet
from bench.venue.layout import FLOOR_HEIGHT_M

FPS = 5.0
FRAMES = 1200
# The hand's motion is made at this number of steps a frame.
STEPS = 2
QUERIES = 60
# A phone held before the body with bent elbows, metres.
ARM_M = 0.35
# Filmed at the marker first: sideways past it, then turning away.
MARKER_STEPS = 50
TURN_STEPS = 20
MARKER_SIDE_M = 0.17
# On the west wall of the lobby, whose inner face is at x = 21.1; a little before it, over what hangs there.
MARKER_XY = (21.15, 15.0)
MARKER_HEIGHT_M = 1.45
START = (22.5, 14.3)
END_OF_MARKER = (22.5, 15.7)


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmedFloor:
    """A storey and the walk through it; `seed` is that of the hand, and `building` the one that it is in."""

    name: str
    floor: int
    stops: str
    seed: int
    building: Building = DEMONSTRATION

    @property
    def walk(self) -> tuple[Walk, ...]:
        """The walk after the marker."""
        return (Walk(self.floor, stops_of(self.stops), arm_m=ARM_M),)

    def of_building(self, number: int) -> FilmedFloor:
        """Return the same walk through another building, by another hand; 0 is the demonstration."""
        if number == 0:
            return self
        name, seed = f"{self.name} of building {number}", self.seed + 10 * number
        return replace(self, name=name, seed=seed, building=Building(number=number))

    @property
    def marker_at(self) -> tuple[float, float, float]:
        """The middle of the marker, world metres."""
        return (*MARKER_XY, self.floor * FLOOR_HEIGHT_M + MARKER_HEIGHT_M)


# From the lobby down both look-alike corridors and back, once round the west half, and back to the lobby.
UPPER = FilmedFloor(
    name="upper",
    floor=1,
    stops=(
        "22.5,15.7 22.8,11.0 22.8,6.8 26.0,6.2 32.0,6.1 40.6,6.2,190 32.0,6.3 26.0,6.2 22.8,7.6 22.6,12.0 22.8,18.0 "
        "26.0,20.0 32.0,19.9 40.6,20.0,190 32.0,20.1 26.0,20.0 22.8,18.4 22.6,12.0 19.0,12.0 13.0,9.0 13.0,6.6 "
        "12.6,4.6,150 10.8,4.0 8.4,4.2 6.6,3.6 6.4,7.4 5.0,11.2,-120 5.0,14.0 4.6,22.0,150 8.8,21.5 11.2,21.5 "
        "12.4,20.0 17.6,20.4,120 15.5,18.4 15.5,16.0 16.4,11.0 19.0,12.0 22.4,12.0 22.6,14.6"
    ),
    seed=2,
)
# From the lobby down one of the corridors and back, round the exhibition and the rooms beside it, and back.
GROUND = FilmedFloor(
    name="ground",
    floor=0,
    stops=(
        "22.5,15.7 22.8,18.0 26.0,20.0 32.0,20.1 40.6,20.0,-190 32.0,19.9 26.0,20.1 22.8,18.4 22.6,12.0 19.0,12.0 "
        "15.6,12.6,160 14.6,9.4 14.5,6.8 13.6,5.2,200 11.2,6.0 9.0,4.4 6.2,4.8,-180 3.6,6.6 3.4,9.2 3.4,12.8,200 "
        "5.6,15.6 7.2,16.4 7.0,19.4 5.0,22.2,-200 8.0,23.2 12.0,23.0 14.6,23.8,150 18.6,22.6 18.6,19.4 14.2,18.6 "
        "14.2,15.4 18.8,11.6 22.4,12.0 22.8,7.6 26.0,6.2 32.0,6.1 32.0,9.0 31.6,10.2,150 32.0,8.6 32.0,6.2 "
        "26.0,6.2 22.8,7.6 22.6,12.0 22.6,14.6"
    ),
    seed=3,
)
FLOORS = {each.name: each for each in (UPPER, GROUND)}


@dataclass(frozen=True, slots=True)
class FloorVideo:
    """The frames of the video, their true poses, the phone pictures, and the frames' depth where it was measured."""

    frames: tuple[Path, ...]
    world_from_camera: tuple[Pose, ...]
    queries: tuple[DemoQuery, ...]
    depth: tuple[Path, ...] = ()


def video_poses(filmed: FilmedFloor = UPPER) -> list[Pose]:
    """Return world_from_camera of each frame: past the marker, and along the walk."""
    steps, ground_m = STEPS * FRAMES, filmed.floor * FLOOR_HEIGHT_M
    walk = scan_poses(filmed.walk, steps - MARKER_STEPS - TURN_STEPS, seed=filmed.seed)
    first = walk[0]
    rng = seeded("marker hand", steps)
    hand = gaussian_filter1d(rng.standard_normal((MARKER_STEPS + TURN_STEPS, 3)), 4, axis=0, mode="wrap")
    ahead = first.rotation[:, 2]
    to_walk = np.arctan2(ahead[1], ahead[0])
    turn = (to_walk - np.pi + np.pi) % (2 * np.pi) - np.pi
    found = []
    for k, (bob, pitch, yaw) in enumerate(hand):
        along = np.clip(k / MARKER_STEPS, 0, 1)
        x, y = (1 - along) * np.array(START) + along * np.array(END_OF_MARKER)
        part = np.clip((k - MARKER_STEPS) / TURN_STEPS, 0, 1)
        # The arm swings round the body, as in the turns of the walk.
        end = first.translation[:2] - np.array(END_OF_MARKER)
        heading = np.pi + part * turn + np.radians(2.0 * yaw)
        place = np.array([x + part * end[0], y + part * end[1], ground_m + SCAN_HEIGHT_M + 0.02 * bob])
        found.append(camera_pose(place, float(heading), float(np.radians(-4 + 3.0 * pitch)), 0.0))
    return [*found, *walk][::STEPS]


def marker_sheet(filmed: FilmedFloor = UPPER) -> MarkerSheet:
    """Return the sheet on the lobby's wall; a viewer who looks west sees north to the right."""
    rotation = np.column_stack([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
    return MarkerSheet(
        number=0, side_m=MARKER_SIDE_M, world_from_sheet=Pose(rotation, np.array(filmed.marker_at))
    )


def render_floor_video(
    directory: Path,
    filmed: FilmedFloor = UPPER,
    *,
    frames: int = FRAMES,
    queries: int = QUERIES,
    workers: int = 2,
    progress: Progress | None = None,
    with_depth: bool = False,
) -> FloorVideo:
    """Render the first `frames` into `directory/frames` and the pictures into `directory/queries`, or return when
    they are there; `with_depth` into `directory/scan`, as a scanner records them. Raises `InvalidInputError` when the
    directory holds something else."""
    poses = video_poses(filmed)[:frames]
    folder = directory / ("scan" if with_depth else "frames")

    def fill(partial: Path) -> None:
        jobs = [
            FrameJob(
                camera=SCAN_CAMERA,
                world_from_camera=pose,
                colour_path=partial / f"{k:06d}.jpg",
                depth_path=partial / f"{k:06d}.png" if with_depth else None,
                seed=("floor video", k) if filmed is UPPER else (f"{filmed.name} video", k),
                sensor=ColourSensor(),
                quality=FAST,
                sheet=marker_sheet(filmed),
            )
            for k, pose in enumerate(poses)
        ]
        make_frames(partial, jobs, workers, progress, filmed.building)

    recipe = {
        "video": filmed.name,
        "frames": frames,
        "version": SCENE_VERSION,
        **filmed.building.recipe,
    }
    make_directory(folder, {**recipe, "depth": True} if with_depth else recipe, fill)
    asked = render_queries_near(
        poses,
        directory / "queries",
        queries,
        region=f"{filmed.name} video",
        workers=workers,
        progress=progress,
        building=filmed.building,
    )
    files = tuple(folder / f"{k:06d}.jpg" for k in range(frames))
    depth = tuple(file.with_suffix(".png") for file in files) if with_depth else ()
    return FloorVideo(files, tuple(poses), tuple(asked), depth)


if __name__ == "__main__":
    render_floor_video(
        Path(sys.argv[1]),
        FLOORS[sys.argv[2]] if len(sys.argv) > 2 else UPPER,
        workers=1,
        progress=lambda done, total: print(f"{done} of {total}", flush=True),
    )
