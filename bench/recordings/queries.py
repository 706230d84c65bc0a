"""Phone pictures with known poses, for measuring how well the venue's maps answer."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from app.errors import InvalidInputError
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from bench.recordings.cache import make_directory, write_whole
from bench.recordings.scan import VENUE_FRAMES, WING_FRAMES
from bench.recordings.trajectory import VENUE_WALK, WING_WALK, query_poses, scan_poses
from bench.render.frames import FrameJob, Progress, make_frames
from bench.render.noise import seeded
from bench.render.scene import DEMONSTRATION, SCENE_VERSION, Building
from bench.render.sensor import ColourSensor
from bench.venue.layout import CORRIDORS, FLOOR_HEIGHT_M, WING_ROOMS, Room, room_at

# A phone: another focal length than the scanner's, and a lens that bends lines a little.
PHONE_CAMERA = Camera("OPENCV", 640, 480, (498.0, 498.5, 322.4, 236.8, 0.062, -0.105, 0.0006, -0.0004))
# wing: what `render_wing` scans; corridors: the four look-alike ones; east: the ground floor outside the wing;
# upper: the floor above; venue: anywhere.
REGIONS = ("wing", "corridors", "east", "upper", "venue")


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoQuery:
    """A phone picture: its file, camera and true pose, the room it was taken in and that room's floor."""

    name: str
    path: Path
    camera: Camera
    world_from_camera: Pose
    room: str
    floor: int


def render_queries(
    directory: Path,
    count: int,
    *,
    region: str = "wing",
    camera: Camera = PHONE_CAMERA,
    seed: int = 1,
    workers: int = 1,
    progress: Progress | None = None,
) -> list[DemoQuery]:
    """Render pictures up to 0.6 m and 30 degrees off a scan's poses, and write `queries.json` beside them.

    Returns at once when the directory holds them. Raises `InvalidInputError` for an unknown region, or when
    the directory holds something else.
    """
    if region not in REGIONS:
        raise InvalidInputError(f"Region {region!r} is not known; use one of {', '.join(REGIONS)}.")
    return render_queries_near(
        _region_poses(region), directory, count, region, camera, seed, workers, progress
    )


def render_queries_near(
    scan: list[Pose],
    directory: Path,
    count: int,
    region: str,
    camera: Camera = PHONE_CAMERA,
    seed: int = 1,
    workers: int = 1,
    progress: Progress | None = None,
    building: Building = DEMONSTRATION,
) -> list[DemoQuery]:
    """Render pictures near the poses of any scan, which `region` names, in a building.

    Otherwise as `render_queries`.
    """
    poses = query_poses(scan, count, seed)
    queries = [_query(directory, k, camera, pose) for k, pose in enumerate(poses)]
    recipe = {
        "queries": region,
        "count": count,
        "seed": seed,
        "version": SCENE_VERSION,
        "camera": [camera.model, camera.width, camera.height, *camera.params],
        **building.recipe,
    }

    def fill(partial: Path) -> None:
        jobs = [
            FrameJob(
                camera=camera,
                world_from_camera=q.world_from_camera,
                colour_path=partial / q.path.name,
                depth_path=None,
                seed=(f"query{seed}", k),
                sensor=phone_sensor(seeded("phone sensor", seed, k)),
            )
            for k, q in enumerate(queries)
        ]
        make_frames(partial, jobs, workers, progress, building)
        listed = {"region": region, "queries": [query_as_dict(q) for q in queries]}
        write_whole(partial / "queries.json", json.dumps(listed, indent=1).encode())

    make_directory(directory, recipe, fill)
    return queries


def _region_poses(region: str) -> list[Pose]:
    """Return the scan poses of a region."""
    if region == "wing":
        return scan_poses(WING_WALK, WING_FRAMES)
    return [pose for pose in scan_poses(VENUE_WALK, VENUE_FRAMES) if _is_in(room_of(pose), region)]


def room_of(world_from_camera: Pose) -> Room | None:
    """Return the room a camera is in."""
    x, y, _ = world_from_camera.translation
    return room_at(x, y, floor_of(world_from_camera))


def floor_of(world_from_camera: Pose) -> int:
    """Return the floor a camera is on, by its height: 0 is the ground floor."""
    return int(world_from_camera.translation[2] > FLOOR_HEIGHT_M)


def _is_in(room: Room | None, region: str) -> bool:
    if room is None or room.id == "stair":
        return False
    return {
        "corridors": room.id in CORRIDORS,
        "east": room.floor == 0 and room.id not in WING_ROOMS,
        "upper": room.floor == 1,
        "venue": True,
    }[region]


def _query(directory: Path, number: int, camera: Camera, pose: Pose) -> DemoQuery:
    room = room_of(pose)
    name = f"query_{number:04d}"
    return DemoQuery(
        name=name,
        path=directory / f"{name}.jpg",
        camera=camera,
        world_from_camera=pose,
        room=room.id if room else "",
        floor=floor_of(pose),
    )


def phone_sensor(rng: np.random.Generator) -> ColourSensor:
    """Return a phone's sensor, exposing each picture a little differently and moving in some."""
    return ColourSensor(
        read_noise=1.6,
        shot_noise=0.18,
        vignetting=0.1,
        exposure=float(rng.uniform(0.85, 1.1)),
        blur_px=float(max(0.0, rng.normal(0, 1.2))),
        blur_angle_deg=float(rng.uniform(0, 180)),
    )


def query_as_dict(query: DemoQuery) -> dict[str, Any]:
    """Return a query as `queries.json` lists it."""
    camera, pose = query.camera, query.world_from_camera
    position = dict(zip("xyz", pose.translation.tolist(), strict=True))
    quaternion = dict(zip("xyzw", pose.quaternion.tolist(), strict=True))
    return {
        "name": query.name,
        "image": query.path.name,
        "room": query.room,
        "floor": query.floor,
        "camera": {
            "model": camera.model,
            "width": camera.width,
            "height": camera.height,
            "params": list(camera.params),
        },
        "pose": {"position": position, "quaternion": quaternion},
    }
