"""A map's points thinned to a number that a page can draw, with colours from the keyframes' pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterator
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
    coarse_ratio: int = limit(
        4,
        "Edges of voxels are doubled while there are more voxels than this many times the points that are wanted, then "
        "grow by a quarter.",
        chosen="By hand: half the edge has four times as many voxels on a surface.",
    )
    chunk_features: int = limit(
        65_536,
        "Features of a map that are read at once.",
        chosen="By hand: some megabytes of memory, and a few thousandths of a second.",
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
    """Return the rows of at most `max_points` features of a map, spread evenly over its space, in their order.

    The map is read in chunks: memory is bounded by `max_points`, whatever the size of the map.
    """
    box = _box_of(artifact)
    if box is None:
        return np.zeros(0, np.intp)
    voxel_m = OPTIONS.first_voxel_m
    while True:
        rows = _first_in_voxels(artifact, box, voxel_m, OPTIONS.coarse_ratio * max_points)
        if rows is not None and len(rows) <= max_points:
            return rows
        voxel_m *= 2.0 if rows is None else 1.25


def _chunks(artifact: MapArtifact) -> Iterator[tuple[NDArray[np.intp], NDArray[np.float64]]]:
    """Yield the rows (n,) and points (n, 3) of the features that can be drawn, in their order, n > 0."""
    arrays = artifact.arrays
    for start in range(0, artifact.feature_count, OPTIONS.chunk_features):
        chunk = slice(start, start + OPTIONS.chunk_features)
        points = arrays.points_in_world[chunk].astype(np.float64)
        usable = (arrays.point_sigma_m[chunk] <= OPTIONS.max_sigma_m) & np.isfinite(points).all(axis=1)
        if usable.any():
            yield np.flatnonzero(usable) + start, points[usable]


def _box_of(artifact: MapArtifact) -> NDArray[np.float64] | None:
    """Return the least and the largest coordinates (2, 3) of all that can be drawn, None when nothing can."""
    boxes = [(points.min(axis=0), points.max(axis=0)) for _, points in _chunks(artifact)]
    if not boxes:
        return None
    lower, upper = zip(*boxes, strict=True)
    return np.stack([np.min(lower, axis=0), np.max(upper, axis=0)])


def _first_in_voxels(
    artifact: MapArtifact, box: NDArray[np.float64], voxel_m: float, max_voxels: int
) -> NDArray[np.intp] | None:
    """Return the row of the first feature in each voxel, in ascending order; None for more than `max_voxels`."""
    _, height, depth = (np.floor((box[1] - box[0]) / voxel_m) + 1).astype(np.int64)
    keys, rows = np.zeros(0, np.int64), np.zeros(0, np.intp)
    for chunk_rows, points in _chunks(artifact):
        x, y, z = np.floor((points - box[0]) / voxel_m).astype(np.int64).T
        found, first = np.unique((x * height + y) * depth + z, return_index=True)
        after = np.searchsorted(keys, found)
        is_new = np.ones(len(found), dtype=bool)
        inside = after < len(keys)
        is_new[inside] = keys[after[inside]] != found[inside]
        keys = np.insert(keys, after[is_new], found[is_new])
        rows = np.insert(rows, after[is_new], chunk_rows[first[is_new]])
        if len(keys) > max_voxels:
            return None
    return np.sort(rows)


def drawn_points(
    artifact: MapArtifact, rows: NDArray[np.intp], picture_of: Callable[[int], NDArray[np.uint8] | None]
) -> DrawnPoints:
    """Return the points of some features, in ascending order, coloured by the pixel that shows each.

    `picture_of` gives the picture (height, width, 3) of a keyframe in RGB at any scale, None where there is none.
    """
    rgb = np.full((len(rows), 3), UNKNOWN_RGB, np.uint8)
    owners = np.searchsorted(artifact.arrays.offsets, rows, side="right") - 1
    keyframes, starts = np.unique(owners, return_index=True)
    for keyframe, start, end in zip(keyframes, starts, [*starts[1:], len(rows)], strict=True):
        picture = picture_of(int(keyframe))
        if picture is None:
            continue
        mine = slice(start, end)
        scale = picture.shape[1] / artifact.camera(int(keyframe)).width
        pixels = np.round(artifact.arrays.keypoints_px[rows[mine]] * scale).astype(int)
        limits = np.array([picture.shape[1] - 1, picture.shape[0] - 1])
        u, v = np.clip(pixels, 0, limits).T
        rgb[mine] = picture[v, u]
    return DrawnPoints(artifact.arrays.points_in_world[rows].astype(np.float32), rgb)
