"""Rendered pictures of monitoring cameras on the demonstration venue's walls and of phones that see the same POI."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidInputError
from app.geometry.camera import Camera
from app.geometry.se3 import Pose, rotation_from_quaternion, rotation_from_vector
from bench.recordings.cache import is_complete, make_directory, write_whole
from bench.recordings.monitor_views import PrintView, sample_view
from bench.recordings.queries import PHONE_CAMERA, phone_sensor
from bench.render.frames import FrameJob, Progress, make_frames
from bench.render.noise import seeded
from bench.render.scene import DEMONSTRATION, SCENE_VERSION, Building, demo_scene
from bench.render.sensor import ColourSensor
from bench.venue.layout import ROOMS, Room

Floats = NDArray[np.float64]

# A wide camera of another focal length and resolution than the phone's.
MONITOR_CAMERA = Camera("PINHOLE", 1280, 720, (760.0, 760.0, 636.5, 362.0))
TURNS = 6
# Raise it whenever a change makes the pairs differ.
PROTOCOL_VERSION = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class MonitorPair:
    """A monitoring camera's picture and a phone's; both show the first of the monitoring camera's `pois`.

    `seen` names all prints that the phone sees; `angle_deg` is the angle between the two lines of sight at the
    first POI, `distance_m` its distance from the phone.
    """

    name: str
    floor: int
    monitor: Path
    phone: Path
    world_from_monitor: Pose
    world_from_phone: Pose
    pois: tuple[PrintView, ...]
    seen: tuple[str, ...]
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
    rooms: Sequence[Room] = ROOMS,
) -> list[MonitorPair]:
    """Render pairs with angles and distances inside the ranges; `pairs.json` in the directory lists them.

    They are of the `rooms` in turn.

    Returns at once when the directory holds them. Raises `InvalidInputError` when the building has not as many.
    """
    recipe = {
        "monitor pairs": count,
        "angles": list(angles_deg),
        "distances": list(distances_m),
        "seed": seed,
        "version": [SCENE_VERSION, PROTOCOL_VERSION],
        "camera": [phone_camera.model, phone_camera.width, phone_camera.height, *phone_camera.params],
        **({} if rooms is ROOMS else {"rooms": [room.id for room in rooms]}),
    }
    if not is_complete(directory, recipe):
        pairs = _sampled(directory, count, angles_deg, distances_m, seed, phone_camera, rooms)

        def fill(partial: Path) -> None:
            jobs = [job for pair in pairs for job in _jobs(partial, pair, seed, phone_camera)]
            make_frames(partial, jobs, workers, progress)
            write_whole(
                partial / "pairs.json", json.dumps([_as_dict(pair) for pair in pairs], indent=1).encode()
            )

        make_directory(directory, recipe, fill)
    listed = json.loads((directory / "pairs.json").read_text())
    return [_from_dict(directory, values) for values in listed]


def render_rolled_phones(
    directory: Path,
    pairs: Sequence[MonitorPair],
    roll_deg: float,
    *,
    seed: int = 1,
    workers: int = 1,
    phone_camera: Camera = PHONE_CAMERA,
    progress: Progress | None = None,
) -> list[MonitorPair]:
    """Render the phones of pairs again, each turned counter-clockwise about its optical axis by that many degrees.

    Returns the pairs with the new pictures and poses; renders nothing when the directory holds them.
    """
    roll = Pose(rotation_from_vector(np.array([0.0, 0.0, -np.radians(roll_deg)])), np.zeros(3))
    rolled = [
        replace(
            pair,
            phone=directory / pair.phone.name,
            world_from_phone=pair.world_from_phone @ roll,
        )
        for pair in pairs
    ]
    recipe = {
        "rolled phones": [pair.name for pair in pairs],
        "roll": roll_deg,
        "seed": seed,
        "version": [SCENE_VERSION, PROTOCOL_VERSION],
        "camera": [phone_camera.model, phone_camera.width, phone_camera.height, *phone_camera.params],
    }

    def fill(partial: Path) -> None:
        jobs = [_jobs(partial, pair, seed, phone_camera)[1] for pair in rolled]
        make_frames(partial, jobs, workers, progress)

    if not is_complete(directory, recipe):
        make_directory(directory, recipe, fill)
    return rolled


def render_again(
    directory: Path,
    pairs: Sequence[MonitorPair],
    *,
    seed: int = 1,
    workers: int = 1,
    phone_camera: Camera = PHONE_CAMERA,
    building: Building = DEMONSTRATION,
    progress: Progress | None = None,
) -> list[MonitorPair]:
    """Render pairs once more with the same poses: with another phone, or in another light.

    Both cameras keep their white balance: the light's colour is that of the pictures. Returns the pairs with the new
    pictures; renders nothing when the directory holds them.
    """
    again = [
        replace(pair, monitor=directory / pair.monitor.name, phone=directory / pair.phone.name)
        for pair in pairs
    ]
    recipe = {
        "pairs again": [pair.name for pair in pairs],
        "of": pairs[0].monitor.parent.name if pairs else "",
        "seed": seed,
        "version": [SCENE_VERSION, PROTOCOL_VERSION],
        "camera": [phone_camera.model, phone_camera.width, phone_camera.height, *phone_camera.params],
        **building.recipe,
    }

    def fill(partial: Path) -> None:
        gains = building.daylight.gains
        jobs = [job for pair in again for job in _jobs(partial, pair, seed, phone_camera, gains)]
        make_frames(partial, jobs, workers, progress, building)

    if not is_complete(directory, recipe):
        make_directory(directory, recipe, fill)
    return again


def _jobs(
    directory: Path,
    pair: MonitorPair,
    seed: int,
    phone_camera: Camera,
    gains: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> list[FrameJob]:
    rng = seeded("monitor pairs", seed, pair.name)
    fixed = ColourSensor(
        read_noise=2.2, shot_noise=0.2, vignetting=0.2, exposure=float(rng.uniform(0.8, 1.1)), gains=gains
    )
    held = replace(phone_sensor(rng), gains=gains)
    number = int(pair.name.split("_")[1])
    return [
        FrameJob(
            camera=MONITOR_CAMERA,
            world_from_camera=pair.world_from_monitor,
            colour_path=directory / pair.monitor.name,
            depth_path=None,
            seed=(f"monitor{seed}", number),
            sensor=fixed,
        ),
        FrameJob(
            camera=phone_camera,
            world_from_camera=pair.world_from_phone,
            colour_path=directory / pair.phone.name,
            depth_path=None,
            seed=(f"phone{seed}", number),
            sensor=held,
        ),
    ]


def _sampled(
    directory: Path,
    count: int,
    angles_deg: tuple[float, float],
    distances_m: tuple[float, float],
    seed: int,
    phone_camera: Camera,
    rooms: Sequence[Room],
) -> list[MonitorPair]:
    rng, scene = seeded("monitors", seed, f"{angles_deg} {distances_m}"), demo_scene()
    pairs: list[MonitorPair] = []
    for turn in range(TURNS * count):
        # Room by room, so that consecutive cameras see different places.
        room = rooms[turn % len(rooms)]
        view = sample_view(rng, scene, room, (MONITOR_CAMERA, phone_camera), angles_deg, distances_m)
        if view is not None:
            name = f"pair_{len(pairs):04d}"
            pairs.append(
                MonitorPair(
                    name=name,
                    floor=room.floor,
                    monitor=directory / f"{name}_monitor.jpg",
                    phone=directory / f"{name}_phone.jpg",
                    world_from_monitor=view.world_from_monitor,
                    world_from_phone=view.world_from_phone,
                    pois=view.pois,
                    seen=view.seen,
                    angle_deg=view.angle_deg,
                    distance_m=view.distance_m,
                )
            )
        if len(pairs) == count:
            return pairs
    raise InvalidInputError(f"The building has only {len(pairs)} pairs with such angles and distances.")


def _as_dict(pair: MonitorPair) -> dict[str, Any]:
    poses = {"monitor_pose": pair.world_from_monitor, "phone_pose": pair.world_from_phone}
    return {
        "name": pair.name,
        "floor": pair.floor,
        "monitor": pair.monitor.name,
        "phone": pair.phone.name,
        "pois": [
            {"id": poi.id, "region_px": poi.corners_px.tolist(), "in_world": poi.in_world.tolist()}
            for poi in pair.pois
        ],
        "seen": list(pair.seen),
        "angle_deg": pair.angle_deg,
        "distance_m": pair.distance_m,
        **{name: [*pose.translation.tolist(), *pose.quaternion.tolist()] for name, pose in poses.items()},
    }


def _from_dict(directory: Path, values: dict[str, Any]) -> MonitorPair:
    monitor, phone = (_pose(values[key]) for key in ("monitor_pose", "phone_pose"))
    pois = tuple(
        PrintView(poi["id"], np.array(poi["region_px"]), np.array(poi["in_world"])) for poi in values["pois"]
    )
    return MonitorPair(
        name=values["name"],
        floor=values["floor"],
        monitor=directory / values["monitor"],
        phone=directory / values["phone"],
        world_from_monitor=monitor,
        world_from_phone=phone,
        pois=pois,
        seen=tuple(values["seen"]),
        angle_deg=values["angle_deg"],
        distance_m=values["distance_m"],
    )


def _pose(numbers: list[float]) -> Pose:
    return Pose(rotation_from_quaternion(*numbers[3:]), np.array(numbers[:3]))
