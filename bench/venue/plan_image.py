"""The floors' plans: where a plan's axes lie in the world, and the drawing an architect would give."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.geometry.se3 import Pose, rotation_from_vector
from bench.venue.decor import furniture_of
from bench.venue.layout import (
    BUILDING_M,
    DOORS,
    FLOOR_HEIGHT_M,
    ROOMS,
    WALL_THICKNESS_M,
    WINDOWS,
    Door,
    Room,
    room_by_id,
)
from bench.venue.openings import shared_wall

Floats = NDArray[np.float64]
Picture = NDArray[np.uint8]

METERS_PER_PIXEL = 0.02
# Plans are turned against the world, and each floor is shifted differently: code that mixes up plan and world fails.
PLAN_TURN_DEG = 90.0
PLAN_SHIFT_M = {0: (30.5, 3.25), 1: (28.25, 1.5)}
MARGIN_M = 1.0

PAPER = (255, 255, 255)
WALL = (52, 48, 46)
GROUND = (250, 248, 246)
WET = (242, 236, 226)
FURNITURE = (178, 174, 168)
INK = (60, 52, 44)
GLASS = (214, 176, 120)
FAINT = (120, 116, 112)


def plan_from_world(floor: int) -> Pose:
    """Return a floor's plan_from_world: turned about the vertical, shifted, its z counted from that floor."""
    x, y = PLAN_SHIFT_M[floor]
    rotation = rotation_from_vector([0, 0, np.radians(PLAN_TURN_DEG)])
    return Pose(rotation, np.array([x, y, -floor * FLOOR_HEIGHT_M]))


def to_plan(points_xy: ArrayLike, floor: int) -> Floats:
    """Return world x, y (n, 2) as plan x, y (n, 2)."""
    points = np.asarray(points_xy, dtype=np.float64).reshape(-1, 2)
    height = np.full(len(points), floor * FLOOR_HEIGHT_M)
    return np.asarray(plan_from_world(floor).apply(np.column_stack([points, height]))[:, :2])


def _extent(floor: int) -> Floats:
    """Return the plan's (x0, y0, x1, y1): the building with a margin, and the plan's origin."""
    w, d = BUILDING_M
    corners = to_plan([(0, 0), (w, 0), (w, d), (0, d)], floor)
    low = np.minimum(corners.min(axis=0) - MARGIN_M, -0.5)
    return np.concatenate([low, corners.max(axis=0) + MARGIN_M])


def origin_px(floor: int) -> tuple[float, float]:
    """Return the pixel of plan (0, 0); u grows with plan x, v falls as plan y grows."""
    x0, _, _, y1 = _extent(floor)
    return round(-x0 / METERS_PER_PIXEL), round(y1 / METERS_PER_PIXEL)


class _Drawing:
    """A picture one draws on in world metres."""

    def __init__(self, floor: int) -> None:
        x0, y0, x1, y1 = _extent(floor)
        size = round((y1 - y0) / METERS_PER_PIXEL), round((x1 - x0) / METERS_PER_PIXEL), 3
        self.floor, self.image = floor, np.full(size, PAPER, np.uint8)

    def pixels(self, points_xy: ArrayLike) -> NDArray[np.int32]:
        """Return world points (n, 2) as pixels (n, 2) with four binary digits after the point."""
        plan = to_plan(points_xy, self.floor) / METERS_PER_PIXEL
        return np.round((plan * [1, -1] + origin_px(self.floor)) * 16).astype(np.int32)

    def area(self, points_xy: ArrayLike, colour: tuple[int, int, int]) -> None:
        cv2.fillPoly(self.image, [self.pixels(points_xy)], colour, cv2.LINE_AA, 4)

    def line(
        self, points_xy: ArrayLike, colour: tuple[int, int, int], thick: int = 1, closed: bool = False
    ) -> None:
        cv2.polylines(self.image, [self.pixels(points_xy)], closed, colour, thick, cv2.LINE_AA, 4)

    def name(self, text: str, middle_xy: tuple[float, float], width_m: float, upright: bool) -> None:
        """Write a text around a point, small enough for a width on the plan; upright reads from below."""
        u, v = (self.pixels([middle_xy])[0] / 16).astype(int)
        scale = min(0.95, 0.9 * width_m / METERS_PER_PIXEL / _text_width(text))
        w, h = int(_text_width(text) * scale) + 12, int(34 * scale) + 12
        halo, ink = np.zeros((h, w), np.float32), np.zeros((h, w), np.float32)
        for mask, thick in ((halo, 7), (ink, 2)):
            at = (6, h - 6 - int(8 * scale))
            cv2.putText(mask, text, at, cv2.FONT_HERSHEY_SIMPLEX, scale, 1.0, thick, cv2.LINE_AA)
        if upright:
            halo, ink = np.rot90(halo), np.rot90(ink)
        top, left = v - halo.shape[0] // 2, u - halo.shape[1] // 2
        part = self.image[top : top + halo.shape[0], left : left + halo.shape[1]]
        for mask, shade in ((halo, PAPER), (ink, INK)):
            part[:] = part * (1 - mask[..., None]) + np.array(shade) * mask[..., None]


def _text_width(text: str) -> int:
    return int(cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 1.0, 2)[0][0])


def plan_png(floor: int) -> bytes:
    """Return a floor's plan as a PNG file."""
    drawing = _Drawing(floor)
    w, d = BUILDING_M
    drawing.area([(-0.1, -0.1), (w + 0.1, -0.1), (w + 0.1, d + 0.1), (-0.1, d + 0.1)], WALL)
    rooms = [room for room in ROOMS if room.floor == floor or room.id == "stair"]
    for room in rooms:
        drawing.area(_rectangle(room), WET if "restrooms" in room.id else GROUND)
        _furniture(drawing, room)
    for door in DOORS:
        if door.floor == floor:
            _door(drawing, door)
    _windows(drawing, floor)
    _lift_cross(drawing, floor)
    for room in rooms:
        _name(drawing, room)
    ok, data = cv2.imencode(".png", drawing.image)
    if not ok:
        raise OSError("OpenCV could not encode the plan")
    return data.tobytes()


def _rectangle(room: Room) -> list[tuple[float, float]]:
    x0, y0, x1, y1 = room.interior
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


def _furniture(drawing: _Drawing, room: Room) -> None:
    for box in furniture_of(room):
        if box.is_obstacle:
            drawing.line(box.corners_xy(), FURNITURE, 1, closed=True)


def _door(drawing: _Drawing, door: Door) -> None:
    """Draw a gap in the wall, and for doors of one leaf the leaf and the arc it swings along."""
    side, _, line = shared_wall(door)
    a, b, half = door.at_m - door.width_m / 2, door.at_m + door.width_m / 2, WALL_THICKNESS_M / 2 + 0.02

    def points(*pairs: tuple[float, float]) -> list[tuple[float, float]]:
        return [(p, q) if side in "NS" else (q, p) for p, q in pairs]

    drawing.area(points((a, line - half), (b, line - half), (b, line + half), (a, line + half)), GROUND)
    if door.closed:
        drawing.line(points((a, line), (b, line)), WALL, 3)
    elif door.width_m <= 1.4:
        angles = np.radians(np.linspace(0, 90, 12))
        arc = [(a + door.width_m * np.cos(t), line + door.width_m * np.sin(t)) for t in angles]
        drawing.line(points((a, line), *arc[::-1]), FAINT)


def _windows(drawing: _Drawing, floor: int) -> None:
    for window in WINDOWS:
        room = room_by_id(window.room)
        if room.floor != floor:
            continue
        x0, y0, x1, y1 = room.bounds
        line = {"N": y1, "S": y0, "E": x1, "W": x0}[window.side]
        a, b = window.at_m - window.width_m / 2, window.at_m + window.width_m / 2
        ends = [(a, line), (b, line)] if window.side in "NS" else [(line, a), (line, b)]
        drawing.line(ends, PAPER, 9)
        drawing.line(ends, GLASS, 3)


def _lift_cross(drawing: _Drawing, floor: int) -> None:
    a, b, c, d = _rectangle(room_by_id(f"{floor}-lift"))
    drawing.line([a, c], FAINT)
    drawing.line([b, d], FAINT)


def _name(drawing: _Drawing, room: Room) -> None:
    """Write a room's name; the plan is turned, so what is the world's y runs along the line of text."""
    x0, y0, x1, y1 = room.interior
    along_y, along_x = min(y1 - y0, 6.0), min(x1 - x0, 6.0)
    upright = along_y < 3.0 and along_x > along_y
    drawing.name(room.name, ((x0 + x1) / 2, (y0 + y1) / 2), along_x if upright else along_y, upright)
