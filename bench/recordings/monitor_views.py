"""Where monitoring cameras hang in the demonstration venue, which prints they see, and phones that see one of them.

The protocol follows the thesis (C section 4), with limits of its own below: camera and phone both see the POI, from the
same room, with a given angle between their lines of sight at the POI and a given distance from it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import shapely  # type: ignore[import-untyped]
from numpy.typing import NDArray

from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from bench.render.scene import Scene
from bench.render.surfaces import Box
from bench.venue.decor import wall_prints
from bench.venue.layout import FLOOR_HEIGHT_M, Room
from bench.venue.walkable import free_space

Floats = NDArray[np.float64]

MONITOR_HEIGHT_M = (2.2, 2.6)
PHONE_HEIGHT_M = (1.35, 1.65)
# A POI is a whole print: this far inside the picture.
BORDER_PX = 8.0
# Least width and height of a POI in a monitoring frame.
MIN_MONITOR_PX = 45.0
# Least width and height of a POI in a phone's picture.
MIN_PHONE_PX = 30.0
# Largest angle between a line of sight and the normal of a POI: no grazing views.
MAX_INCIDENCE_DEG = 65.0
# An operator marks more than one POI, and only a few.
MIN_POIS = 2
MAX_POIS = 4
MONITOR_M = (2.0, 12.5)
# Largest ratio of the two cameras' distances to the POI.
MAX_DISTANCE_RATIO = 2.0
CAMERAS_TRIED = 40
PHONES_TRIED = 60
GRID = np.array([(s, t) for s in (0.05, 0.5, 0.95) for t in (0.05, 0.5, 0.95)])


@dataclass(frozen=True, slots=True)
class PrintView:
    """A print as a camera sees it: its name, its corners in the picture (4, 2), and the world point (3,) that the
    middle of that region shows."""

    id: str
    corners_px: Floats
    in_world: Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class SampledView:
    """A monitoring camera with its POIs, and a phone that sees the first of them; `seen` names all the prints that the
    phone sees."""

    world_from_monitor: Pose
    pois: tuple[PrintView, ...]
    world_from_phone: Pose
    seen: tuple[str, ...]
    angle_deg: float
    distance_m: float


def sample_view(
    rng: np.random.Generator,
    scene: Scene,
    room: Room,
    cameras: tuple[Camera, Camera],
    angles_deg: tuple[float, float],
    distances_m: tuple[float, float],
) -> SampledView | None:
    """Return a monitoring camera and a phone in a room, or None when the tries have found none.

    `cameras` are the monitoring camera's and the phone's; the angle at the POI and its distance from the phone lie
    inside the ranges.
    """
    prints = wall_prints(room)
    for _ in range(CAMERAS_TRIED if len(prints) >= MIN_POIS else 0):
        main = str(rng.choice(list(prints)))
        world_from_monitor = _monitor_pose(rng, room, _middle(prints[main]))
        views = visible_prints(scene, cameras[0], world_from_monitor, prints, MIN_MONITOR_PX)
        if main not in views or len(views) < MIN_POIS:
            continue
        poi = views[main]
        away_m = float(np.linalg.norm(world_from_monitor.translation - poi.in_world))
        if not MONITOR_M[0] <= away_m <= MONITOR_M[1]:
            continue
        for _ in range(PHONES_TRIED):
            phone = _phone_pose(rng, room, world_from_monitor, poi.in_world, angles_deg, distances_m)
            if phone is None:
                continue
            angle_deg, distance_m = _angle_and_distance(world_from_monitor, phone, poi.in_world)
            ratio = max(away_m / distance_m, distance_m / away_m)
            if not angles_deg[0] <= angle_deg <= angles_deg[1] or ratio > MAX_DISTANCE_RATIO:
                continue
            seen = visible_prints(scene, cameras[1], phone, prints, MIN_PHONE_PX)
            if main in seen:
                others = [view for name, view in views.items() if name != main]
                others.sort(key=lambda view: -_smaller_side_px(view.corners_px))
                pois = (poi, *others[: MAX_POIS - 1])
                return SampledView(
                    world_from_monitor=world_from_monitor,
                    pois=pois,
                    world_from_phone=phone,
                    seen=tuple(seen),
                    angle_deg=angle_deg,
                    distance_m=distance_m,
                )
    return None


def visible_prints(
    scene: Scene, camera: Camera, world_from_camera: Pose, prints: Mapping[str, Box], min_side_px: float
) -> dict[str, PrintView]:
    """Return the prints that are whole inside a camera's picture, large enough, facing it, and hidden by nothing."""
    found = {}
    for name, box in prints.items():
        corner, right, down = _front(box)
        towards = world_from_camera.translation - (corner + 0.5 * (right + down))
        normal = np.cross(down, right)
        cosine = float(normal @ towards / (np.linalg.norm(normal) * np.linalg.norm(towards)))
        if cosine < np.cos(np.radians(MAX_INCIDENCE_DEG)):
            continue
        corners = np.stack([corner, corner + right, corner + right + down, corner + down])
        corners_px = camera.project(world_from_camera.inverse().apply(corners))
        high = np.array([camera.width, camera.height]) - 1 - BORDER_PX
        if not (
            np.isfinite(corners_px).all() and (corners_px >= BORDER_PX).all() and (corners_px <= high).all()
        ):
            continue
        grid = corner + GRID[:, :1] * right + GRID[:, 1:] * down
        if _smaller_side_px(corners_px) < min_side_px or _is_hidden(
            scene, world_from_camera.translation, grid
        ):
            continue
        found[name] = PrintView(
            name, corners_px, _on_plane(camera, world_from_camera, corners_px, corner, normal)
        )
    return found


def looking(at: Floats, towards: Floats) -> Pose:
    """Return `world_from_camera` of a camera without roll at a point, looking towards another."""
    forward = (towards - at) / np.linalg.norm(towards - at)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return Pose(np.stack([right, np.cross(forward, right), forward], axis=1), at)


def _front(box: Box) -> tuple[Floats, Floats, Floats]:
    """Return the upper left corner (3,) of a box's front and its sides to the right and down."""
    corners = box.corners_xy()
    corner = np.array([*corners[0], box.base_m + box.size_m[2]])
    return corner, np.array([*(corners[1] - corners[0]), 0.0]), np.array([0.0, 0.0, -box.size_m[2]])


def _middle(box: Box) -> Floats:
    corner, right, down = _front(box)
    return np.asarray(corner + 0.5 * (right + down))


def _smaller_side_px(corners_px: Floats) -> float:
    return float(np.linalg.norm(np.roll(corners_px, -1, axis=0) - corners_px, axis=1).min())


def _is_hidden(scene: Scene, eye: Floats, points: Floats) -> bool:
    """Return whether anything lies between an eye (3,) and any of some points (n, 3)."""
    rays = points - eye
    lengths = np.linalg.norm(rays, axis=1)
    directions = (rays / lengths[:, None]).astype(np.float32)
    origins = np.tile(eye.astype(np.float32), (len(points), 1))
    hit_m = np.asarray(scene.embree.run(origins, directions, query="DISTANCE"))
    return bool((hit_m < lengths - 0.02).any())


def _on_plane(
    camera: Camera, world_from_camera: Pose, corners_px: Floats, corner: Floats, normal: Floats
) -> Floats:
    """Return what the middle of a region shows of a plane: where an operator points the laser."""
    ray = world_from_camera.rotation @ np.array([*camera.normalize(_centre_of_area(corners_px))[0], 1.0])
    length = normal @ (corner - world_from_camera.translation) / (normal @ ray)
    return np.asarray(world_from_camera.translation + length * ray)


def _centre_of_area(corners: Floats) -> Floats:
    following = np.roll(corners, -1, axis=0)
    cross = corners[:, 0] * following[:, 1] - following[:, 0] * corners[:, 1]
    return np.asarray(((corners + following) * cross[:, None]).sum(axis=0) / (3.0 * cross.sum()))


def _monitor_pose(rng: np.random.Generator, room: Room, poi: Floats) -> Pose:
    """Return a camera under the ceiling beside a wall, looking down towards a POI or up to 25 degrees past it."""
    x0, y0, x1, y1 = room.interior
    along, inset = rng.uniform(0.1, 0.9), 0.3
    place = [
        (x0 + inset, y0 + along * (y1 - y0)),
        (x1 - inset, y0 + along * (y1 - y0)),
        (x0 + along * (x1 - x0), y0 + inset),
        (x0 + along * (x1 - x0), y1 - inset),
    ][int(rng.integers(4))]
    at = np.array([*place, room.base_m + rng.uniform(*MONITOR_HEIGHT_M)])
    turn = np.radians(rng.uniform(-25.0, 25.0))
    cos, sin = np.cos(turn), np.sin(turn)
    x, y = (poi - at)[:2]
    towards = at + np.array([cos * x - sin * y, sin * x + cos * y, 0.0])
    towards[2] = poi[2] + rng.uniform(-0.5, 0.1)
    return looking(at, towards)


def _phone_pose(
    rng: np.random.Generator,
    room: Room,
    world_from_monitor: Pose,
    poi: Floats,
    angles_deg: tuple[float, float],
    distances_m: tuple[float, float],
) -> Pose | None:
    """Return a phone in the room that looks at the POI, turned about it from the monitoring camera, or None."""
    away = (world_from_monitor.translation - poi)[:2]
    turn = np.radians(rng.uniform(*angles_deg)) * rng.choice([-1.0, 1.0])
    direction = np.arctan2(away[1], away[0]) + turn
    distance = rng.uniform(*distances_m)
    height = room.floor * FLOOR_HEIGHT_M + rng.uniform(*PHONE_HEIGHT_M)
    along = np.sqrt(max(distance**2 - (height - poi[2]) ** 2, 0.01))
    at = np.array([poi[0] + along * np.cos(direction), poi[1] + along * np.sin(direction), height])
    x0, y0, x1, y1 = room.interior
    if not (
        x0 < at[0] < x1 and y0 < at[1] < y1 and shapely.contains_xy(free_space(room.floor), at[0], at[1])
    ):
        return None
    # People look ahead, not at a point: up to a few degrees beside and only half way up or down to it.
    towards = poi + np.array([*rng.uniform(-0.08, 0.08, 2) * distance, 0.0])
    towards[2] = height + 0.5 * (poi[2] - height)
    return looking(at, towards)


def _angle_and_distance(world_from_monitor: Pose, world_from_phone: Pose, poi: Floats) -> tuple[float, float]:
    """Return the angle in degrees between the lines of sight at the POI, and its distance from the phone."""
    to_monitor, to_phone = world_from_monitor.translation - poi, world_from_phone.translation - poi
    lengths = np.linalg.norm(to_monitor), np.linalg.norm(to_phone)
    cosine = np.clip(to_monitor @ to_phone / (lengths[0] * lengths[1]), -1.0, 1.0)
    return float(np.degrees(np.arccos(cosine))), float(lengths[1])
