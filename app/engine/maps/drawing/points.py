"""A map's points thinned to a number that a page can draw, with colours from the keyframes' pictures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.artifact import MapArtifact
from app.limits import limit

# The colour of a point whose keyframe has no picture.
UNKNOWN_RGB = 128
# Header of the binary form: magic, then the number of points as little-endian uint32.
POINTS_MAGIC = b"RFPTS001"
COORDINATE = np.dtype("<f4")


@dataclass(frozen=True, slots=True, kw_only=True)
class DrawnPointOptions:
    """Which points are drawn."""

    max_sigma_m: float = limit(
        0.3,
        "Points with a larger standard deviation along their ray are not drawn.",
        chosen="By hand: a wall is still a line in the view from above.",
    )
    first_voxel_m: float = limit(
        0.02,
        "Edge of the voxels of which one point each is drawn; doubled until few enough points are left.",
        chosen="By hand: below it neighbouring points can't be told apart on a screen.",
    )


OPTIONS = DrawnPointOptions()


@dataclass(frozen=True, slots=True)
class DrawnPoints:
    """Points (n, 3) in the world, metres, and their colours (n, 3) in RGB; grey where no picture is kept."""

    points_in_world: NDArray[np.float32]
    rgb: NDArray[np.uint8]

    def packed(self) -> bytes:
        """Return the magic, the count n (uint32), n x 3 float32 metres, n x 3 uint8 RGB; little-endian."""
        count = len(self.points_in_world).to_bytes(4, "little")
        return POINTS_MAGIC + count + self.points_in_world.astype(COORDINATE).tobytes() + self.rgb.tobytes()

    def ply(self) -> bytes:
        """Return a binary PLY file with x, y, z, red, green, blue."""
        names = [f"property float {axis}" for axis in "xyz"]
        names += [f"property uchar {colour}" for colour in ("red", "green", "blue")]
        header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(self.points_in_world)}"]
        rows = np.zeros(len(self.points_in_world), dtype=[("xyz", COORDINATE, 3), ("rgb", np.uint8, 3)])
        rows["xyz"], rows["rgb"] = self.points_in_world, self.rgb
        return "\n".join([*header, *names, "end_header\n"]).encode() + rows.tobytes()


def thinned_rows(artifact: MapArtifact, max_points: int) -> NDArray[np.intp]:
    """Return the rows of at most `max_points` features of a map, spread evenly over its space, in their order."""
    usable = np.flatnonzero(np.asarray(artifact.arrays.point_sigma_m) <= OPTIONS.max_sigma_m)
    points = np.asarray(artifact.arrays.points_in_world)[usable].astype(np.float64)
    finite = np.isfinite(points).all(axis=1)
    usable, points = usable[finite], points[finite]
    voxel_m = OPTIONS.first_voxel_m
    first = _first_in_voxels(points, voxel_m)
    while len(first) > max_points:
        voxel_m *= 2.0 if len(first) > 4 * max_points else 1.25
        first = _first_in_voxels(points, voxel_m)
    return usable[np.sort(first)]


def _first_in_voxels(points: NDArray[np.float64], voxel_m: float) -> NDArray[np.intp]:
    if len(points) == 0:
        return np.zeros(0, np.intp)
    cells = np.floor((points - points.min(axis=0)) / voxel_m).astype(np.int64)
    sizes = cells.max(axis=0) + 1
    keys = (cells[:, 0] * sizes[1] + cells[:, 1]) * sizes[2] + cells[:, 2]
    return np.unique(keys, return_index=True)[1]


def drawn_points(
    artifact: MapArtifact, rows: NDArray[np.intp], picture_of: Callable[[int], NDArray[np.uint8] | None]
) -> DrawnPoints:
    """Return the points of some features, in ascending order, coloured by the pixel that shows each.

    `picture_of` gives the picture (height, width, 3) of a keyframe in RGB at any scale, None where there is none.
    """
    rgb = np.full((len(rows), 3), UNKNOWN_RGB, np.uint8)
    owners = np.searchsorted(artifact.arrays.offsets, rows, side="right") - 1
    for keyframe in np.unique(owners):
        picture = picture_of(int(keyframe))
        if picture is None:
            continue
        mine = np.flatnonzero(owners == keyframe)
        scale = picture.shape[1] / artifact.camera(int(keyframe)).width
        pixels = np.round(artifact.arrays.keypoints_px[rows[mine]] * scale).astype(int)
        limits = np.array([picture.shape[1] - 1, picture.shape[0] - 1])
        u, v = np.clip(pixels, 0, limits).T
        rgb[mine] = picture[v, u]
    return DrawnPoints(artifact.arrays.points_in_world[rows].astype(np.float32), rgb)
