"""Rectangles and boxes, the only shapes of the building."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bench.render.atlas import Texture
from bench.render.noise import seeded
from bench.venue.layout import Room, Side
from bench.venue.openings import Opening

Vector = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Surface:
    """A rectangle in the world: its top left corner seen from the front; its edges `right`, `down`; metres.

    `offset_m` is the place of the corner on a periodic texture. Surfaces of one `plane` name lie in one plane
    with one texture, so their common border needs no smoothing. `room` says whose lamps light it, `look`
    seeds its stains.
    """

    corner: Vector
    right: Vector
    down: Vector
    texture: Texture
    room: str
    offset_m: tuple[float, float] = (0.0, 0.0)
    plane: str = ""
    look: str = ""
    is_bright: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Box:
    """A box that stands on `base_m` (world z), turned by `yaw_deg` about its vertical middle line.

    `size_m` is width (along its own x), depth (its y) and height. `front` is the face towards its own -y.
    """

    centre: tuple[float, float]
    base_m: float
    size_m: tuple[float, float, float]
    yaw_deg: float = 0.0
    material: str = "wood_light"
    front: Texture | None = None
    back: Texture | None = None
    top: Texture | None = None
    is_obstacle: bool = True

    def corners_xy(self) -> Vector:
        """Return the footprint (4, 2), counter-clockwise from the front left corner."""
        w, d, _ = self.size_m
        local = np.array([(-w, -d), (w, -d), (w, d), (-w, d)]) / 2
        c, s = np.cos(np.radians(self.yaw_deg)), np.sin(np.radians(self.yaw_deg))
        return np.asarray(local @ np.array([[c, s], [-s, c]]) + self.centre)

    def surfaces(self, room: str, look: str) -> list[Surface]:
        """Return the six faces (five when the box stands on a floor and has no underside to see)."""
        p = np.column_stack([self.corners_xy(), np.full(4, self.base_m + self.size_m[2])])
        down = np.array([0, 0, -self.size_m[2]])
        rng = seeded(look, "box")
        faces = [
            self._face(p[k], p[(k + 1) % 4] - p[k], down, picture, room, rng)
            for k, picture in enumerate((self.front, None, self.back, None))
        ]
        faces.append(self._face(p[3], p[2] - p[3], p[0] - p[3], self.top, room, rng))
        bottom = p + down
        faces.append(self._face(bottom[0], bottom[1] - bottom[0], bottom[3] - bottom[0], None, room, rng))
        return [replace(face, look=f"{look}/{k}") for k, face in enumerate(faces)]

    def _face(
        self,
        corner: Vector,
        right: Vector,
        down: Vector,
        picture: Texture | None,
        room: str,
        rng: np.random.Generator,
    ) -> Surface:
        texture = picture or Texture(self.material)
        offset = rng.uniform(0, 3, 2)
        if picture is not None and not picture.is_material:
            size = (float(np.linalg.norm(right)), float(np.linalg.norm(down)))
            texture = replace(picture, size_m=(_rounded(size[0]), _rounded(size[1])))
        return Surface(
            corner=corner,
            right=right,
            down=down,
            texture=texture,
            room=room,
            offset_m=(float(offset[0]), float(offset[1])),
        )


def _rounded(side_m: float) -> float:
    """Return a print's side in steps of a tenth, so that boxes of nearly one size share one print."""
    return max(0.1, round(side_m, 1)) if side_m > 0.25 else max(0.04, round(side_m, 2))


def rectangle(
    corner: ArrayLike, right: ArrayLike, down: ArrayLike, texture: Texture, room: str, look: str
) -> Surface:
    """Return a surface from plain triples of numbers."""
    a, b, c = (np.asarray(v, dtype=np.float64) for v in (corner, right, down))
    return Surface(corner=a, right=b, down=c, texture=texture, room=room, look=look)


@dataclass(frozen=True, slots=True, kw_only=True)
class Wall:
    """The inner face of one side of a room: the world x or y `line_m` it lies at, and its extent along it and
    in z."""

    side: Side
    line_m: float
    start_m: float
    end_m: float
    bottom_m: float
    top_m: float

    @staticmethod
    def of_room(room: Room, side: Side) -> Wall:
        """Return a side of a room."""
        x0, y0, x1, y1 = room.interior
        line = {"N": y1, "S": y0, "E": x1, "W": x0}[side]
        start, end = (x0, x1) if side in "NS" else (y0, y1)
        return Wall(
            side=side,
            line_m=line,
            start_m=start,
            end_m=end,
            bottom_m=room.base_m,
            top_m=room.base_m + room.height_m,
        )

    @property
    def forward(self) -> bool:
        """Whether a viewer inside the room sees the wall's coordinate grow to the right."""
        return self.side in "NW"

    @property
    def inward(self) -> tuple[float, float]:
        """The unit direction (x, y) from the wall into the room."""
        return {"N": (0.0, -1.0), "S": (0.0, 1.0), "E": (-1.0, 0.0), "W": (1.0, 0.0)}[self.side]

    @property
    def yaw_deg(self) -> float:
        """The yaw of a box whose front faces into the room."""
        return {"N": 0.0, "S": 180.0, "E": -90.0, "W": 90.0}[self.side]

    def point(self, along_m: float, z_m: float, off_m: float = 0.0) -> Vector:
        """Return the world point (3,) at a place along the wall, `off_m` in front of it."""
        x, y = (along_m, self.line_m) if self.side in "NS" else (self.line_m, along_m)
        return np.array([x + off_m * self.inward[0], y + off_m * self.inward[1], z_m])

    def piece(
        self, a: float, b: float, z0: float, z1: float, texture: Texture, room: str, look: str
    ) -> Surface:
        """Return the part a..b, z0..z1 of the wall, its texture running on from the wall's left top
        corner."""
        left, right = (a, b) if self.forward else (b, a)
        origin = self.start_m if self.forward else self.end_m
        corner = self.point(left, z1)
        shift = seeded(look, self.side).uniform(0, 4, 2)
        return Surface(
            corner=corner,
            right=self.point(right, z1) - corner,
            down=np.array([0, 0, z0 - z1]),
            texture=texture,
            room=room,
            offset_m=(abs(left - origin) + float(shift[0]), self.top_m - z1 + float(shift[1])),
            plane=f"{room}/{self.side}",
            look=f"{look}/{self.side}/{a - self.start_m:.2f}/{z0 - self.bottom_m:.2f}",
        )

    def pieces(self, openings: list[Opening], texture: Texture, room: str, look: str) -> list[Surface]:
        """Return the wall as rectangles around its openings."""
        holes = [o for o in openings if o.side == self.side]
        cuts = sorted({self.start_m, self.end_m, *(c for o in holes for c in (o.start_m, o.end_m))})
        found = []
        for a, b in pairwise(cuts):
            z = self.bottom_m
            inside = sorted(
                (o for o in holes if o.start_m < b - 1e-6 and o.end_m > a + 1e-6), key=lambda o: o.bottom_m
            )
            for hole in inside:
                if hole.bottom_m > z + 1e-6:
                    found.append(self.piece(a, b, z, hole.bottom_m, texture, room, look))
                z = hole.top_m
            if z < self.top_m - 1e-6:
                found.append(self.piece(a, b, z, self.top_m, texture, room, look))
        return found
