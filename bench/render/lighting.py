"""Baked light: lamps with shadows, darkening in corners, faint stains. One coarse grid of brightness per
surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.render.daylight import LAMPS_ALONE, Daylight, window_light
from bench.render.noise import seeded
from bench.render.surfaces import Surface
from bench.venue.building import lamp_places
from bench.venue.layout import ROOMS

Floats = NDArray[np.float32]

NODE_STEP_M = 0.14
LIGHT_WIDTH = 4096
AMBIENT = 0.66
LAMP_STRENGTH = 1.25
BRIGHTEST = 1.10
NEAREST_LAMPS = 4
CORNER_RAYS = 6
CORNER_REACH_M = 0.7
STAIN = 0.035
# The texture of what is behind the windows.
OUTDOORS = "outdoors"


@dataclass(frozen=True, slots=True)
class LightMap:
    """Brightness factors in one image (h, LIGHT_WIDTH); `origin_px`, `nodes` (n, 2) are each surface's grid
    in it."""

    image: Floats
    origin_px: NDArray[np.float32]
    nodes: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class _Nodes:
    """All grid nodes one after the other: places and normals (m, 3), and the surface each belongs to (m,)."""

    points: Floats
    normals: Floats
    surface: NDArray[np.int64]


def bake(
    surfaces: list[Surface], normals: NDArray[np.float64], embree: Any, daylight: Daylight = LAMPS_ALONE
) -> LightMap:
    """Return the light on surfaces whose unit normals (n, 3) face the viewer, with shadows from an embree
    scene."""
    counts = np.array([_node_counts(s) for s in surfaces])
    nodes = _place_nodes(surfaces, normals, counts)
    light = daylight.lamps * _lamp_light(nodes, surfaces, embree)
    light += daylight.ambient * AMBIENT * _openness(nodes, embree)
    light += window_light(nodes.points, nodes.normals, surfaces, nodes.surface, embree, daylight)
    light = np.minimum(light, BRIGHTEST)
    bright = np.array([s.is_bright for s in surfaces])
    shine = np.array([daylight.outdoors if s.texture.kind == OUTDOORS else 1.0 for s in surfaces])
    light[bright[nodes.surface]] = shine[nodes.surface[bright[nodes.surface]]]
    return _pack(surfaces, counts, light)


def _node_counts(surface: Surface) -> tuple[int, int]:
    if surface.is_bright:
        return 2, 2
    sides = (float(np.linalg.norm(surface.right)), float(np.linalg.norm(surface.down)))
    across, down = (max(2, min(400, int(np.ceil(side / NODE_STEP_M)) + 1)) for side in sides)
    return across, down


def _place_nodes(surfaces: list[Surface], normals: NDArray[np.float64], counts: NDArray[np.int64]) -> _Nodes:
    """Return the nodes, kept a little off the surface and its edges so that a touching one doesn't hide the
    lamps."""
    points = []
    for surface, normal, (nu, nv) in zip(surfaces, normals, counts, strict=True):
        u = np.clip(np.linspace(0, 1, nu), 0.03 / nu, 1 - 0.03 / nu)[None, :, None]
        v = np.clip(np.linspace(0, 1, nv), 0.03 / nv, 1 - 0.03 / nv)[:, None, None]
        grid = surface.corner + u * surface.right + v * surface.down + 0.004 * normal
        points.append(grid.reshape(-1, 3))
    owner = np.repeat(np.arange(len(surfaces)), counts[:, 0] * counts[:, 1])
    return _Nodes(np.concatenate(points).astype(np.float32), normals[owner].astype(np.float32), owner)


def _lamp_light(nodes: _Nodes, surfaces: list[Surface], embree: Any) -> Floats:
    """Return the light from the nearest lamps of each node's own room."""
    light = np.zeros(len(nodes.points), np.float32)
    room_of = np.array([s.room for s in surfaces])[nodes.surface]
    for room in ROOMS:
        mine = np.flatnonzero(room_of == room.id)
        lamps = np.array(lamp_places(room), np.float32)
        offsets = lamps[None] - nodes.points[mine][:, None]
        squared = np.einsum("ijk,ijk->ij", offsets, offsets)
        for k in np.argsort(squared, axis=1)[:, :NEAREST_LAMPS].T if len(mine) else ():
            rows = np.arange(len(mine))
            to_lamp, d2 = offsets[rows, k], squared[rows, k]
            unit = to_lamp / np.sqrt(d2)[:, None]
            facing = np.clip(np.einsum("ij,ij->i", unit, nodes.normals[mine]), 0, 1)
            falloff = facing * (0.35 + 0.65 * np.clip(unit[:, 2], 0, 1)) / (1.5 + d2)
            lit = facing > 0
            lit[lit] = ~_blocked(nodes.points[mine][lit], unit[lit], np.sqrt(d2[lit]) - 0.05, embree)
            light[mine] += LAMP_STRENGTH * falloff * lit
    return light


def _blocked(points: Floats, directions: Floats, reach_m: Floats | float, embree: Any) -> NDArray[np.bool_]:
    """Return which rays hit something within their reach."""
    origins = np.ascontiguousarray(points, np.float32)
    distance = embree.run(origins, np.ascontiguousarray(directions, np.float32), query="DISTANCE")
    return np.asarray(distance < reach_m)


def _openness(nodes: _Nodes, embree: Any) -> Floats:
    """Return how much of the surroundings each node sees within a short reach: small in corners, under
    tables."""
    rng = seeded("openness")
    free = np.zeros(len(nodes.points), np.float32)
    for _ in range(CORNER_RAYS):
        # One set of directions for all nodes: noise from ray to ray would show as speckle that moves with
        # nothing.
        direction = rng.standard_normal(3).astype(np.float32)
        turned = nodes.normals + 0.9 * direction / np.linalg.norm(direction)
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        free += ~_blocked(nodes.points, turned, CORNER_REACH_M, embree)
    return np.asarray(0.55 + 0.45 * free / CORNER_RAYS, dtype=np.float32)


def _pack(surfaces: list[Surface], counts: NDArray[np.int64], light: Floats) -> LightMap:
    """Lay the grids out in rows of one image, stained with noise that depends only on each surface's look."""
    origins = np.zeros((len(surfaces), 2), np.float32)
    order = sorted(range(len(surfaces)), key=lambda k: (-counts[k, 1], k))
    x = y = row_height = 0
    for k in order:
        nu, nv = (int(c) for c in counts[k])
        if x + nu > LIGHT_WIDTH:
            x, y, row_height = 0, y + row_height, 0
        origins[k] = x, y
        x, row_height = x + nu, max(row_height, nv)
    image = np.ones((y + row_height, LIGHT_WIDTH), np.float32)
    starts = np.concatenate([[0], np.cumsum(counts[:, 0] * counts[:, 1])])
    for k, surface in enumerate(surfaces):
        nu, nv = counts[k]
        x, y = origins[k].astype(int)
        grid = light[starts[k] : starts[k + 1]].reshape(nv, nu)
        if not surface.is_bright:
            grid = grid * (1 + STAIN * seeded("stain", surface.look).standard_normal((nv, nu), np.float32))
        image[y : y + nv, x : x + nu] = grid
    return LightMap(image, origins, counts)
