"""The walls of a floor as a grid of cells, and the stairs on which a walker changes floors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from app.engine.floors.model import FloorFeatures, Link
from app.limits import limit

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
# Gives points (n, 2) of a floor's plan in the frame of the poses.
InFrame = Callable[[Array], Array]


@dataclass(frozen=True, slots=True, kw_only=True)
class WallOptions:
    """How areas and links become walls and doors."""

    cell_m: float = limit(0.1, "Side of a cell.", chosen="By hand: half the thickness of a wall.")
    door_m: float = limit(
        0.8,
        "Around the point where a link leaves an area there is no wall within this distance.",
        chosen="By hand: more than half the width of a door, as a link may run along its edge.",
    )
    sample_m: float = limit(
        0.05, "Distance of points along a link at which its area is read.", chosen="By hand: half a cell."
    )
    stairs_m: float = limit(
        1.5,
        "Distance from the line of stairs within which somebody is on them.",
        chosen="By hand: their width.",
    )
    max_cells: int = limit(
        4_000_000,
        "Cells of a floor above which no walls are known.",
        chosen="By hand: 200 m by 200 m, 12 MB.",
    )


OPTIONS = WallOptions()
# The label of cells in no area.
OUTSIDE = -1


@dataclass(frozen=True, slots=True, kw_only=True)
class Stairs:
    """Stairs as drawn on one floor: their line (n, 2) from this floor to another one, and the area that holds them."""

    line: Array
    to_floor: str
    area: int

    def progress(self, points: Array) -> tuple[Array, Array]:
        """Return how far along the line points (n, 2) are, 0 to 1, and their distances from it, metres."""
        start, along = self.line[0], self.line[-1] - self.line[0]
        length = max(float(np.linalg.norm(along)), 1e-6)
        share = (points - start) @ along / length**2
        nearest = start + np.clip(share, 0.0, 1.0)[:, None] * along
        return share, np.linalg.norm(points - nearest, axis=1)


@dataclass(frozen=True, slots=True, kw_only=True)
class FloorWalls:
    """A floor's cells: `area` (rows, columns) is the area that each lies in, `is_door` (rows, columns) where people
    pass from one area to the next; row 0, column 0 begins at `low` (2,), metres of the frame of the poses."""

    low: Array
    area: NDArray[np.int16]
    is_door: Mask
    stairs: tuple[Stairs, ...] = ()

    @staticmethod
    def of(features: FloorFeatures, in_frame: InFrame) -> FloorWalls | None:
        """Return the walls between a floor's areas, with a door where a link crosses; None without areas."""
        rings = [in_frame(np.asarray(area.polygon.exterior.coords)[:, :2]) for area in features.areas]
        if not rings:
            return None
        corners = np.concatenate(rings)
        low, high = corners.min(axis=0) - 1.0, corners.max(axis=0) + 1.0
        columns, rows = np.ceil((high - low) / OPTIONS.cell_m).astype(int) + 1
        if rows * columns > OPTIONS.max_cells:
            return None
        area = np.full((rows, columns), OUTSIDE, np.int16)
        # Large areas first, so that a smaller one inside of them keeps its cells.
        order = np.argsort([-each.polygon.area for each in features.areas], kind="stable")
        for label in order:
            cells = np.rint((rings[label] - low) / OPTIONS.cell_m - 0.5).astype(np.int32)
            cv2.fillPoly(area, [cells], int(label))
        walls = FloorWalls(low=low, area=area, is_door=np.zeros(area.shape, dtype=bool))
        for link in features.links:
            if link.to_floor is None:
                walls._open(in_frame(link.points[:, :2]))
        return FloorWalls(
            low=low, area=area, is_door=walls.is_door, stairs=walls._stairs(features.links, in_frame)
        )

    def _open(self, line: Array) -> None:
        """Open the walls where a link (n, 2) leads from one area to another."""
        points = sampled(line)
        labels = self.labels(points)
        doors = self.is_door.astype(np.uint8)
        radius = max(round(OPTIONS.door_m / OPTIONS.cell_m), 1)
        for k in np.flatnonzero(labels[1:] != labels[:-1]):
            column, row = self._cells(points[k : k + 1])[0]
            cv2.circle(doors, (int(column), int(row)), radius, 1, -1)
        self.is_door[:] = doors.astype(bool)

    def _stairs(self, links: tuple[Link, ...], in_frame: InFrame) -> tuple[Stairs, ...]:
        found = []
        for link in links:
            if link.to_floor is None or link.mode not in ("stairs", "escalator"):
                continue
            line = in_frame(link.points[:, :2])
            middle = 0.5 * (line[0] + line[-1])
            found.append(Stairs(line=line, to_floor=link.to_floor, area=int(self.labels(middle[None])[0])))
        return tuple(found)

    def _cells(self, points: Array) -> NDArray[np.int64]:
        cells = np.floor((points - self.low) / OPTIONS.cell_m).astype(np.int64)
        return np.asarray(np.clip(cells, 0, [self.area.shape[1] - 1, self.area.shape[0] - 1]))

    def labels(self, points: Array) -> NDArray[np.int16]:
        """Return the areas (n,) of points (n, 2)."""
        return self.at(points)[0]

    def at(self, points: Array) -> tuple[NDArray[np.int16], Mask]:
        """Return the areas (n,) of points (n, 2), and which (n,) are at a door."""
        cells = self._cells(points)
        return self.area[cells[:, 1], cells[:, 0]], self.is_door[cells[:, 1], cells[:, 0]]

    def crossed(self, start: Array, end: Array) -> Mask:
        """Return who of (n,) went through a wall on the straight way from `start` to `end`, both (n, 2)."""
        longest = float(np.linalg.norm(end - start, axis=1).max(initial=0.0))
        steps = max(int(np.ceil(longest / OPTIONS.cell_m)), 1)
        crossed = np.zeros(len(start), dtype=bool)
        label, door = self.at(start)
        for k in range(1, steps + 1):
            next_label, next_door = self.at(start + (k / steps) * (end - start))
            crossed |= (next_label != label) & ~(door & next_door)
            label, door = next_label, next_door
        return crossed


def sampled(line: Array) -> Array:
    """Return points (m, 2) along a line (n, 2), close together."""
    parts = []
    for start, end in pairwise(line):
        count = max(int(np.ceil(np.linalg.norm(end - start) / OPTIONS.sample_m)), 1)
        parts.append(start + np.linspace(0.0, 1.0, count + 1)[:, None] * (end - start))
    return np.concatenate(parts)
