"""Monitoring cameras on the demonstration venue's walls, and phones that look at the same POI from elsewhere."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import shapely  # type: ignore[import-untyped]
from numpy.typing import NDArray

from app.demonstration.cache import is_complete, make_directory, write_whole
from app.demonstration.frames import FrameJob, Progress, make_frames
from app.demonstration.layout import FLOOR_HEIGHT_M, ROOMS, Room
from app.demonstration.noise import seeded
from app.demonstration.queries import PHONE_CAMERA
from app.demonstration.raycast import render
from app.demonstration.scene import SCENE_VERSION, Scene, demo_scene
from app.demonstration.sensor import ColourSensor
from app.demonstration.walkable import free_space
from app.errors import InvalidInputError
from app.geometry.camera import Camera
from app.geometry.se3 import Pose, rotation_from_quaternion

Floats = NDArray[np.float64]

# A wide camera of another focal length and resolution than the phone's.
MONITOR_CAMERA = Camera("PINHOLE", 1280, 720, (760.0, 760.0, 636.5, 362.0))
MONITOR_HEIGHT_M, PHONE_HEIGHT_M = (2.2, 2.6), (1.35, 1.65)
REGION_HALF_PX = 60
PREVIEW_SCALE = 4
TRIES_IN_ROOM, PHONES_TRIED, TURNS = 12, 30, 6
SMALLEST_ROOM_M = 2.5
# A POI is something that catches the eye: so many corners, at least, in its region at the preview's resolution.
MIN_CORNERS, CORNER_QUALITY, PLACES_TRIED = 12, 3e-3, 60


@dataclass(frozen=True, slots=True)
class MonitorPair:
    """A monitoring camera's picture, a phone's, and the POI in both: `poi_px` in the monitoring camera's,
    `poi_in_world`; `angle_deg` between the two lines of sight at the POI, `distance_m` from it to the phone."""

    name: str
    floor: int
    monitor: Path
    phone: Path
    world_from_monitor: Pose
    world_from_phone: Pose
    poi_px: tuple[float, float]
    poi_in_world: tuple[float, float, float]
    angle_deg: float
    distance_m: float


def render_monitor_pairs(
    directory: Path,
    count: int,
    angles_deg: tuple[float, float],
    distances_m: tuple[float, float],
    *,
    seed: int = 1,
    workers: int = 1,
    phone_camera: Camera = PHONE_CAMERA,
    progress: Progress | None = None,
) -> list[MonitorPair]:
    """Render pairs with angles and distances inside the ranges; `pairs.json` in the directory lists them.

    Returns at once when the directory holds them. Raises `InvalidInputError` when the building has not as many.
    """
    recipe = {
        "monitor pairs": count,
        "angles": list(angles_deg),
        "distances": list(distances_m),
        "seed": seed,
        "version": SCENE_VERSION,
        "camera": [phone_camera.model, phone_camera.width, phone_camera.height, *phone_camera.params],
    }
    if not is_complete(directory, recipe):
        pairs = _sampled(directory, count, angles_deg, distances_m, seed, phone_camera)

        def fill(partial: Path) -> None:
            jobs = [job for pair in pairs for job in _jobs(partial, pair, seed, phone_camera)]
            make_frames(partial, jobs, workers, progress)
            write_whole(
                partial / "pairs.json", json.dumps([_as_dict(pair) for pair in pairs], indent=1).encode()
            )

        make_directory(directory, recipe, fill)
    listed = json.loads((directory / "pairs.json").read_text())
    return [_from_dict(directory, values) for values in listed]


def _jobs(directory: Path, pair: MonitorPair, seed: int, phone_camera: Camera) -> list[FrameJob]:
    rng = seeded("monitor pairs", seed, pair.name)
    fixed = ColourSensor(
        read_noise=2.2, shot_noise=0.2, vignetting=0.2, exposure=float(rng.uniform(0.8, 1.1))
    )
    held = ColourSensor(
        read_noise=1.6,
        shot_noise=0.18,
        vignetting=0.1,
        exposure=float(rng.uniform(0.85, 1.1)),
        blur_px=float(max(0.0, rng.normal(0, 1.2))),
        blur_angle_deg=float(rng.uniform(0, 180)),
    )
    number = int(pair.name.split("_")[1])
    return [
        FrameJob(
            MONITOR_CAMERA,
            pair.world_from_monitor,
            directory / pair.monitor.name,
            None,
            (f"monitor{seed}", number),
            fixed,
        ),
        FrameJob(
            phone_camera,
            pair.world_from_phone,
            directory / pair.phone.name,
            None,
            (f"phone{seed}", number),
            held,
        ),
    ]


def _sampled(
    directory: Path,
    count: int,
    angles_deg: tuple[float, float],
    distances_m: tuple[float, float],
    seed: int,
    phone_camera: Camera,
) -> list[MonitorPair]:
    rng, scene = seeded("monitors", seed, f"{angles_deg} {distances_m}"), demo_scene()
    rooms = [room for room in ROOMS if min(_size_m(room)) > SMALLEST_ROOM_M and room.id != "stair"]
    pairs: list[MonitorPair] = []
    for turn in range(TURNS * count):
        # Room by room, so that consecutive cameras see different places.
        room = rooms[turn % len(rooms)]
        for _ in range(TRIES_IN_ROOM):
            name = f"pair_{len(pairs):04d}"
            pair = _tried(rng, scene, room, name, directory, angles_deg, distances_m, phone_camera)
            if pair is not None:
                pairs.append(pair)
                break
        if len(pairs) == count:
            return pairs
    raise InvalidInputError(f"The building has only {len(pairs)} pairs with such angles and distances.")


def _tried(
    rng: np.random.Generator,
    scene: Scene,
    room: Room,
    name: str,
    directory: Path,
    angles_deg: tuple[float, float],
    distances_m: tuple[float, float],
    phone_camera: Camera,
) -> MonitorPair | None:
    world_from_monitor = _monitor_pose(rng, room)
    sight = _poi(rng, scene, world_from_monitor)
    if sight is None:
        return None
    poi_px, poi = sight
    phones = (
        _phone_pose(rng, room, world_from_monitor, poi, angles_deg, distances_m) for _ in range(PHONES_TRIED)
    )
    world_from_phone = next((phone for phone in phones if phone is not None), None)
    if world_from_phone is None or not _sees(scene, phone_camera, world_from_phone, poi):
        return None
    to_monitor, to_phone = world_from_monitor.translation - poi, world_from_phone.translation - poi
    lengths = np.linalg.norm(to_monitor), np.linalg.norm(to_phone)
    angle = float(np.degrees(np.arccos(np.clip(to_monitor @ to_phone / (lengths[0] * lengths[1]), -1, 1))))
    if not angles_deg[0] <= angle <= angles_deg[1]:
        return None
    return MonitorPair(
        name,
        room.floor,
        directory / f"{name}_monitor.jpg",
        directory / f"{name}_phone.jpg",
        world_from_monitor,
        world_from_phone,
        (float(poi_px[0]), float(poi_px[1])),
        (float(poi[0]), float(poi[1]), float(poi[2])),
        angle,
        float(lengths[1]),
    )


def _size_m(room: Room) -> tuple[float, float]:
    x0, y0, x1, y1 = room.interior
    return x1 - x0, y1 - y0


def looking(at: Floats, towards: Floats) -> Pose:
    """Return `world_from_camera` of a camera without roll at a point, looking towards another."""
    forward = (towards - at) / np.linalg.norm(towards - at)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return Pose(np.stack([right, np.cross(forward, right), forward], axis=1), at)


def _monitor_pose(rng: np.random.Generator, room: Room) -> Pose:
    """Return a camera under the ceiling beside a wall, looking into the room and down."""
    x0, y0, x1, y1 = room.interior
    along, inset = rng.uniform(0.1, 0.9), 0.3
    place = [
        (x0 + inset, y0 + along * (y1 - y0)),
        (x1 - inset, y0 + along * (y1 - y0)),
        (x0 + along * (x1 - x0), y0 + inset),
        (x0 + along * (x1 - x0), y1 - inset),
    ][int(rng.integers(4))]
    base = room.floor * FLOOR_HEIGHT_M
    at = np.array([*place, base + rng.uniform(*MONITOR_HEIGHT_M)])
    towards = np.array([rng.uniform(x0, x1), rng.uniform(y0, y1), base + rng.uniform(0.8, 1.6)])
    return looking(at, towards)


def _poi(rng: np.random.Generator, scene: Scene, world_from_monitor: Pose) -> tuple[Floats, Floats] | None:
    """Return a pixel and the world point it shows; whole regions fit into the picture, and its depth is even."""
    camera = MONITOR_CAMERA
    small = camera.scaled_to(camera.width // PREVIEW_SCALE, camera.height // PREVIEW_SCALE)
    rgb, depth_m = render(scene, small, world_from_monitor)
    half = REGION_HALF_PX // PREVIEW_SCALE
    corners = cv2.cornerMinEigenVal(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), 3)
    peaks = (corners > CORNER_QUALITY) & (corners >= cv2.dilate(corners, np.ones((3, 3), np.uint8)))
    counts = cv2.boxFilter(peaks.astype(np.float32), -1, (2 * half + 1, 2 * half + 1), normalize=False)
    places = rng.integers(
        [half + 1, half + 1], [small.width - half - 1, small.height - half - 1], (PLACES_TRIED, 2)
    )
    u, v = max(places.tolist(), key=lambda place: float(counts[place[1], place[0]]))
    if counts[v, u] < MIN_CORNERS:
        return None
    around = depth_m[v - half // 2 : v + half // 2 + 1, u - half // 2 : u + half // 2 + 1]
    if not (np.isfinite(around).all() and around.min() > 1.5 and np.ptp(around) < 0.2 * around.min()):
        return None
    pixel = np.array([[float(u), float(v)]])
    point = world_from_monitor.apply(small.unproject(pixel, np.array([float(depth_m[v, u])])))[0]
    full = (pixel[0] + 0.5) * PREVIEW_SCALE - 0.5
    return full, np.asarray(point)


def _phone_pose(
    rng: np.random.Generator,
    room: Room,
    world_from_monitor: Pose,
    poi: Floats,
    angles_deg: tuple[float, float],
    distances_m: tuple[float, float],
) -> Pose | None:
    """Return a phone that looks at the POI, turned about it from the monitoring camera, or None off the floor."""
    away = (world_from_monitor.translation - poi)[:2]
    turn = np.radians(rng.uniform(*angles_deg)) * rng.choice([-1.0, 1.0])
    direction = np.arctan2(away[1], away[0]) + turn
    distance = rng.uniform(*distances_m)
    height = room.floor * FLOOR_HEIGHT_M + rng.uniform(*PHONE_HEIGHT_M)
    along = np.sqrt(max(distance**2 - (height - poi[2]) ** 2, 0.01))
    at = np.array([poi[0] + along * np.cos(direction), poi[1] + along * np.sin(direction), height])
    if not shapely.contains_xy(free_space(room.floor), at[0], at[1]):
        return None
    # People look ahead, not at a point: up to a few degrees beside and only half way up or down to it.
    towards = poi + np.array([*rng.uniform(-0.08, 0.08, 2) * distance, 0.0])
    towards[2] = height + 0.5 * (poi[2] - height)
    return looking(at, towards)


def _sees(scene: Scene, camera: Camera, world_from_camera: Pose, poi: Floats) -> bool:
    """Return whether the POI is inside the picture and nothing hides it."""
    small = camera.scaled_to(camera.width // PREVIEW_SCALE, camera.height // PREVIEW_SCALE)
    in_camera = world_from_camera.inverse().apply(poi[None])
    pixel = small.project(in_camera)[0]
    if not np.isfinite(pixel).all() or not (
        3 <= pixel[0] <= small.width - 4 and 3 <= pixel[1] <= small.height - 4
    ):
        return False
    _, depth_m = render(scene, small, world_from_camera)
    seen = float(depth_m[round(pixel[1]), round(pixel[0])])
    return bool(abs(seen - in_camera[0, 2]) < 0.05 * in_camera[0, 2] + 0.05)


def _as_dict(pair: MonitorPair) -> dict[str, Any]:
    values = {
        key: value
        for key, value in asdict(pair).items()
        if key not in ("world_from_monitor", "world_from_phone")
    }
    for key, pose in (("monitor_pose", pair.world_from_monitor), ("phone_pose", pair.world_from_phone)):
        values[key] = [*pose.translation.tolist(), *pose.quaternion.tolist()]
    return {**values, "monitor": pair.monitor.name, "phone": pair.phone.name}


def _from_dict(directory: Path, values: dict[str, Any]) -> MonitorPair:
    monitor, phone = (_pose(values[key]) for key in ("monitor_pose", "phone_pose"))
    u, v = values["poi_px"]
    x, y, z = values["poi_in_world"]
    return MonitorPair(
        values["name"],
        values["floor"],
        directory / values["monitor"],
        directory / values["phone"],
        monitor,
        phone,
        (u, v),
        (x, y, z),
        values["angle_deg"],
        values["distance_m"],
    )


def _pose(numbers: list[float]) -> Pose:
    return Pose(rotation_from_quaternion(*numbers[3:]), np.array(numbers[:3]))
