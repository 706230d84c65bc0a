"""The demonstration venue as a simulation's building and phone: walls, stairs, pictures with passers-by, sessions."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from app.engine.navigation.places import PlanPlace
from app.geometry.camera import Camera
from app.services.sessions import SessionFrame, SessionService
from bench.render.raycast import FAST, render
from bench.render.scene import Scene
from bench.render.sensor import JPEG_QUALITY, ColourSensor, colour_picture
from bench.simulation.walks import Answer, Shot
from bench.venue.layout import (
    DOORS,
    STAIR_RISERS,
    STAIR_START_Y_M,
    STAIR_TREAD_M,
    room_by_id,
)
from bench.venue.walkable import CELL_M, grid_of, ground_z_m, way_out

# Least distance of a person's middle from walls.
BODY_M = 0.2
STAIR_TOP_Y_M = STAIR_START_Y_M + (STAIR_RISERS - 1) * STAIR_TREAD_M
# Distance beyond its door at which a walker has left the stairwell.
OUTSIDE_M = 1.0
# The lens of the demonstration's phone, a horizontal field of view of 65 degrees.
FOCAL_SHARE = 498.0 / 640.0
EXPOSURE_S = 1.0 / 100.0
# Mean time from one passer-by to the next.
PASSER_EVERY_S = 15.0
# How long a passer-by walks.
PASSER_WALKS_S = 4.0
PASSER_HEIGHT_M = 1.7
PASSER_WIDTH_M = 0.5
PASSER_SPEED_M_S = 1.1
# Standard deviation of a phone's gravity about each axis.
GRAVITY_SIGMA_RAD = float(np.radians(1.0))
NEAREST_M = 0.7


def phone_camera(width: int) -> Camera:
    """Return the phone's camera for pictures of a width, 4 to 3."""
    height = round(0.75 * width)
    focal = FOCAL_SHARE * width
    return Camera("PINHOLE", width, height, (focal, focal, (width - 1) / 2, (height - 1) / 2))


class DemoBuilding:
    """The demonstration building for walkers."""

    def is_free(self, x: float, y: float, floor: int) -> bool:
        """Return whether a person can stand at a point."""
        if _on_stairs(x, y):
            return True
        clearance = _clearance(floor)
        row, column = int(y / CELL_M), int(x / CELL_M)
        inside = 0 <= row < clearance.shape[0] and 0 <= column < clearance.shape[1]
        return inside and bool(clearance[row, column] > BODY_M)

    def floor_at(self, x: float, y: float, floor: int) -> int:
        """Return the floor: the lower half of the stairs is on the ground floor."""
        if not _on_stairs(x, y):
            return floor
        return int(y > (STAIR_START_Y_M + STAIR_TOP_Y_M) / 2)

    def ground_m(self, x: float, y: float, floor: int) -> float:
        """Return the world z underfoot."""
        return ground_z_m(x, y, floor)

    def stairs_end(self, x: float, y: float, up: bool) -> tuple[float, float] | None:
        """Return the middle of the landing that the stairs lead to, for somebody there a point beyond its door."""
        x0, y0, x1, y1 = room_by_id("stair").interior
        if not (x0 < x < x1 and y0 < y < y1):
            return None
        door_y = next(door.at_m for door in DOORS if door.b == "stair" and door.floor == int(up))
        there = y > STAIR_TOP_Y_M + BODY_M if up else y < STAIR_START_Y_M - BODY_M
        return (x0 - OUTSIDE_M, door_y) if there else ((x0 + x1) / 2, door_y)

    def way_out(self, x: float, y: float, floor: int) -> list[tuple[float, float]]:
        """Return the way through the nearest door, as points."""
        found = way_out((x, y), floor)
        return [] if found is None else [(float(u), float(v)) for u, v in found]


def _on_stairs(x: float, y: float) -> bool:
    x0, _, x1, _ = room_by_id("stair").interior
    return x0 + BODY_M < x < x1 - BODY_M and STAIR_START_Y_M - 0.4 < y < STAIR_TOP_Y_M + 0.4


@lru_cache(maxsize=4)
def _clearance(floor: int) -> NDArray[np.float64]:
    return grid_of(floor).clearance_m


@dataclass(slots=True)
class _Passer:
    """Somebody who walks by: where they were first, their way in metres a second, until when, their clothes."""

    start_xyz: NDArray[np.float64]
    along: NDArray[np.float64]
    since_s: float
    cloth: NDArray[np.uint8]


class Phone:
    """Takes pictures of the rendered building, with somebody passing by now and then."""

    def __init__(self, scene: Scene, camera: Camera) -> None:
        self.camera = camera
        self._scene = scene
        self._passer: _Passer | None = None
        self._next_s = 0.0

    def reset(self) -> None:
        """Send everybody away."""
        self._passer, self._next_s = None, 0.0

    def take(self, shot: Shot, rng: np.random.Generator) -> bytes:
        """Return a picture as JPEG."""
        rgb, depth_m = render(self._scene, self.camera, shot.world_from_camera, FAST)
        self._meet(shot, rng)
        if self._passer is not None:
            _draw(rgb, depth_m, self.camera, shot, self._passer)
        turned_px = abs(np.radians(shot.turned_deg_s)) * EXPOSURE_S * self.camera.params[0]
        shaken_px = max(0.0, float(rng.normal(0, 0.8))) * self.camera.width / 640.0
        sensor = ColourSensor(
            read_noise=1.6,
            shot_noise=0.18,
            vignetting=0.1,
            exposure=shot.light * float(rng.uniform(0.85, 1.1)),
            blur_px=float(turned_px) + shaken_px,
            blur_angle_deg=0.0 if turned_px > shaken_px else float(rng.uniform(0, 180)),
        )
        picture = colour_picture(rng, rgb, self.camera, sensor)
        flags = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
        return cv2.imencode(".jpg", picture[..., ::-1], flags)[1].tobytes()

    def _meet(self, shot: Shot, rng: np.random.Generator) -> None:
        """Let somebody come by, and go."""
        if self._passer is not None and shot.time_s - self._passer.since_s > PASSER_WALKS_S:
            self._passer = None
        if self._next_s == 0.0:
            self._next_s = shot.time_s + float(rng.exponential(PASSER_EVERY_S))
        if self._passer is None and shot.time_s >= self._next_s:
            self._next_s = shot.time_s + PASSER_WALKS_S + float(rng.exponential(PASSER_EVERY_S))
            self._passer = _come(shot, rng)


def _come(shot: Shot, rng: np.random.Generator) -> _Passer:
    """Return somebody who crosses ahead of the camera from one side, or comes towards it."""
    rotation, side = shot.world_from_camera.rotation, float(rng.choice([-1.0, 1.0]))
    right, ahead = rotation[:, 0] * [1, 1, 0], rotation[:, 2] * [1, 1, 0]
    start = shot.world_from_camera.translation + rng.uniform(2.0, 5.0) * ahead + side * 1.5 * right
    way = -side * right - rng.uniform(0.0, 1.0) * ahead
    cloth = rng.integers(20, 235, (6, 2, 3)).astype(np.uint8)
    return _Passer(start, PASSER_SPEED_M_S * way / max(float(np.linalg.norm(way)), 1e-6), shot.time_s, cloth)


def _draw(
    rgb: NDArray[np.uint8], depth_m: NDArray[np.float32], camera: Camera, shot: Shot, passer: _Passer
) -> None:
    """Paint a person into a picture where nothing is nearer: a trunk in their clothes, a head."""
    place = passer.start_xyz + (shot.time_s - passer.since_s) * passer.along
    x, _, z = shot.world_from_camera.inverse().apply(place)
    if z < NEAREST_M:
        return
    fx, fy, cx, cy = camera.params[:4]
    middle, eye = cx + fx * x / z, cy
    half = fx * PASSER_WIDTH_M / 2 / z
    # The camera is held a little below the top of their heads.
    top, bottom = eye - fy * 0.15 / z, eye + fy * (PASSER_HEIGHT_M - 0.15) / z
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float32)
    head = ((u - middle) / (0.35 * half)) ** 2 + ((v - top) / (0.55 * half)) ** 2 <= 1
    trunk = (np.abs(u - middle) <= half) & (v >= top + 0.5 * half) & (v <= bottom)
    body = (head | trunk) & ((depth_m > z) | (depth_m == 0))
    if not body.any():
        return
    rows = np.clip((v - top) / max(bottom - top, 1.0) * len(passer.cloth), 0, len(passer.cloth) - 1)
    columns = (u > middle).astype(int)
    rgb[body] = passer.cloth[rows.astype(int), columns][body]


class SessionNavigator:
    """Sends a phone's pictures to the session service of a venue, as the server does."""

    def __init__(
        self, service: SessionService, venue: str, phone: Phone, *, sends_gravity: bool = False
    ) -> None:
        self._service = service
        self._venue = venue
        self._phone = phone
        self._sends_gravity = sends_gravity
        self._session = ""

    def begin(self, destination: str) -> None:
        """Begin a session."""
        camera = self._phone.camera
        self._phone.reset()
        numbers = ",".join(f"{value:g}" for value in camera.params)
        self._session = self._service.create(self._venue, numbers, destination, "en").id

    def ask(self, shot: Shot, rng: np.random.Generator) -> Answer:
        """Take a picture and return the answer to it."""
        image = self._phone.take(shot, rng)
        begun = time.perf_counter()
        gravity = _gravity(shot, rng) if self._sends_gravity else None
        frame = SessionFrame(image, time_s=shot.time_s, gravity=gravity)
        answer = self._service.process(self._session, frame)
        milliseconds = 1e3 * (time.perf_counter() - begun)
        floor, plan = answer.result.floor, answer.result.plan
        place = None if floor is None or plan is None else PlanPlace(floor.id, plan.x, plan.y)
        accuracy = answer.result.accuracy
        return Answer(answer.guidance, place, milliseconds, None if accuracy is None else accuracy.position_m)

    def end(self) -> None:
        """End the session."""
        self._service.delete(self._session)


def _gravity(shot: Shot, rng: np.random.Generator) -> tuple[float, float, float]:
    """Return down in camera axes as a phone's accelerometer states it."""
    down = shot.world_from_camera.rotation.T @ np.array([0.0, 0.0, -1.0])
    x, y, z = down + rng.normal(0.0, GRAVITY_SIGMA_RAD, 3)
    return float(x), float(y), float(z)
