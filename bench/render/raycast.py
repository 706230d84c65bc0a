"""The renderer: one ray per pixel finds the rectangle, its plane gives exact depth and texture place, mipmaps
the colour."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from bench.render.atlas import LEVELS
from bench.render.scene import Scene

Floats = NDArray[np.float32]
Ints = NDArray[np.int32]

# Where the rays of a pixel that two surfaces share are cast, in pixels from its centre.
EDGE_OFFSETS_PX = ((-0.125, -0.375), (0.375, -0.125), (0.125, 0.375), (-0.375, 0.125))
# Number of texels averaged along the longer side of a pixel's footprint on the texture.
PROBES = 4
# Added to the mipmap level. Negative, so sharper: interpolation inside a mipmap blurs already.
LEVEL_BIAS = -0.35
REMAP_COLUMNS = 1024


@dataclass(frozen=True, slots=True)
class Quality:
    """How finely pictures are rendered.

    `probes` places are averaged along a long footprint, `blended` mixes two mipmap levels instead of taking the
    nearest, `every_ray` casts a ray through each pixel instead of only where the neighbours' differ, and
    `smooth` averages four rays where surfaces meet.
    """

    probes: int = PROBES
    blended: bool = True
    every_ray: bool = True
    smooth: bool = True


# For long simulations: a third of the time; except on the thinnest things the difference is below a sensor's noise.
FAST = Quality(probes=2, blended=False, every_ray=False, smooth=False)
FINE = Quality()
UNKNOWN = -2


@dataclass(frozen=True, slots=True)
class _Rays:
    """Viewing rays in camera axes at depth 1: x and y (n,), and how much each changes from pixel to pixel."""

    x: Floats
    y: Floats
    step_x: Floats
    step_y: Floats


@lru_cache(maxsize=4)
def camera_rays(camera: Camera) -> _Rays:
    """Return the rays through all pixel centres, row by row; lens distortion included."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    points = camera.normalize(np.column_stack([u.ravel(), v.ravel()])).astype(np.float32)
    grid = points.reshape(camera.height, camera.width, 2)
    step_x, step_y = np.gradient(grid[..., 0], axis=1), np.gradient(grid[..., 1], axis=0)
    return _Rays(
        np.ascontiguousarray(points[:, 0]),
        np.ascontiguousarray(points[:, 1]),
        np.ascontiguousarray(step_x.ravel(), np.float32),
        np.ascontiguousarray(step_y.ravel(), np.float32),
    )


@dataclass(frozen=True, slots=True)
class _View:
    """A scene seen from one pose: per rectangle the rows (n,) of the map from ray (x, y, 1) to (s, t, 1) /
    depth."""

    scene: Scene
    world_from_camera: Pose
    rows: Floats
    plane_depth: Floats


def _view(scene: Scene, world_from_camera: Pose) -> _View:
    """A point of the plane with normal n at z r, seen along r = (x, y, 1), has z = n.(O - C) / (n.R r)."""
    rotation, origin = world_from_camera.rotation, scene.corner - world_from_camera.translation
    unit_s = scene.right / np.linalg.norm(scene.right, axis=1, keepdims=True)
    unit_t = scene.down / np.linalg.norm(scene.down, axis=1, keepdims=True)
    normal = np.cross(unit_t, unit_s)
    distance = np.einsum("ij,ij->i", normal, origin)[:, None]
    row_n = normal @ rotation
    row_s = distance * (unit_s @ rotation) - np.einsum("ij,ij->i", unit_s, origin)[:, None] * row_n
    row_t = distance * (unit_t @ rotation) - np.einsum("ij,ij->i", unit_t, origin)[:, None] * row_n
    rows = np.stack([row_s, row_t, row_n]).transpose(0, 2, 1).reshape(9, -1)
    return _View(
        scene, world_from_camera, np.ascontiguousarray(rows, np.float32), distance[:, 0].astype(np.float32)
    )


def _cast(view: _View, x: Floats, y: Floats) -> Ints:
    """Return the rectangle each ray meets first, -1 for none."""
    directions = np.empty((len(x), 3), np.float32)
    rotation = view.world_from_camera.rotation.astype(np.float32)
    for axis in range(3):
        directions[:, axis] = rotation[axis, 0] * x + rotation[axis, 1] * y + rotation[axis, 2]
    origins = np.empty_like(directions)
    origins[:] = view.world_from_camera.translation
    hit = view.scene.embree.run(origins, directions, output=1)["primID"]
    return np.asarray(hit >> 1, dtype=np.int32)


def _cast_where_needed(view: _View, rays: _Rays, shape: tuple[int, int]) -> Ints:
    """Return the rectangle each pixel's ray meets first, where that of every other pixel's neighbours is one and
    the same without casting it."""
    x, y = rays.x.reshape(shape), rays.y.reshape(shape)
    seen = x[::2, ::2].shape
    coarse = _cast(view, x[::2, ::2].ravel(), y[::2, ::2].ravel()).reshape(seen)
    surface = np.full(shape, UNKNOWN, np.int32)
    surface[::2, ::2] = coarse
    beside, below = coarse[:, 1:] == coarse[:, :-1], coarse[1:] == coarse[:-1]
    surface[::2, 1:-1:2] = np.where(beside, coarse[:, 1:], UNKNOWN)[:, : surface[::2, 1:-1:2].shape[1]]
    surface[1:-1:2, ::2] = np.where(below, coarse[1:], UNKNOWN)[: surface[1:-1:2].shape[0]]
    inner = np.where(beside[1:] & beside[:-1] & below[:, 1:], coarse[1:, 1:], UNKNOWN)
    surface[1:-1:2, 1:-1:2] = inner[: surface[1:-1:2].shape[0], : surface[:, 1:-1:2].shape[1]]
    rest = np.flatnonzero(surface == UNKNOWN)
    flat = surface.ravel()
    flat[rest] = _cast(view, rays.x[rest], rays.y[rest])
    return flat


@dataclass(frozen=True, slots=True, kw_only=True)
class _Hits:
    """Where rays meet the scene: rectangle (n,), place s, t in metres, depth, and change of s, t from pixel
    to pixel."""

    surface: Ints
    s: Floats
    t: Floats
    depth: Floats
    s_u: Floats
    s_v: Floats
    t_u: Floats
    t_v: Floats


def _intersect(view: _View, surface: Ints, rays: _Rays) -> _Hits:
    """Intersect rays with the planes of their rectangles."""
    a, b, c, d, e, f, g, h, i = (row.take(surface) for row in view.rows)
    x, y = rays.x, rays.y
    inverse = 1 / (g * x + h * y + i)
    s, t = (a * x + b * y + c) * inverse, (d * x + e * y + f) * inverse
    across, down = inverse * rays.step_x, inverse * rays.step_y
    return _Hits(
        surface=surface,
        s=s,
        t=t,
        depth=view.plane_depth.take(surface) * inverse,
        s_u=(a - s * g) * across,
        s_v=(b - s * h) * down,
        t_u=(d - t * g) * across,
        t_v=(e - t * h) * down,
    )


def _sample(scene: Scene, texture: Ints, s: Floats, t: Floats, level: Ints) -> Floats:
    """Return the colours (n, 3) of textures at level-0 texel places s, t, taken from one mipmap level
    each."""
    row = texture * LEVELS + level
    base = texture * LEVELS
    width, height = scene.atlas_size[:, 0], scene.atlas_size[:, 1]
    u = s * (width.take(row) / width.take(base))
    v = t * (height.take(row) / height.take(base))
    u += scene.atlas_origin[:, 0].take(row) - 0.5
    v += scene.atlas_origin[:, 1].take(row) - 0.5
    return _look_up(scene.atlas, u, v)


def _look_up(image: NDArray[np.uint8] | Floats, u: Floats, v: Floats) -> Floats:
    """Interpolate an image at n places; in rows, as cv2.remap takes no very long single one."""
    n = len(u)
    rows = -(-n // REMAP_COLUMNS)
    maps = np.zeros((2, rows * REMAP_COLUMNS), np.float32)
    maps[0, :n], maps[1, :n] = u, v
    grid = maps.reshape(2, rows, REMAP_COLUMNS)
    out = cv2.remap(image, grid[0], grid[1], cv2.INTER_LINEAR)
    return np.asarray(out.reshape(rows * REMAP_COLUMNS, -1)[:n], dtype=np.float32)


def _wrapped(place: Floats, size: Floats, periodic: NDArray[np.bool_]) -> Floats:
    """Return texel places brought into the texture: modulo its size if it repeats, else clamped to it."""
    modulo = place - np.floor(place / size) * size
    return np.where(periodic, modulo, np.clip(place, 0, size))


def _shade(scene: Scene, hits: _Hits, quality: Quality) -> Floats:
    """Return the colours (n, 3), 0 to 255: texture averaged over each pixel's footprint, times baked
    light."""
    surface = hits.surface
    texture = scene.texture.take(surface)
    scale_s, scale_t = scene.texel_scale[:, 0].take(surface), scene.texel_scale[:, 1].take(surface)
    place_s = hits.s * scale_s + scene.texel_offset[:, 0].take(surface)
    place_t = hits.t * scale_t + scene.texel_offset[:, 1].take(surface)
    su, sv, tu, tv = hits.s_u * scale_s, hits.s_v * scale_s, hits.t_u * scale_t, hits.t_v * scale_t
    length_u, length_v = np.hypot(su, tu), np.hypot(sv, tv)
    long_is_u = length_u > length_v
    major = np.maximum(np.maximum(length_u, length_v), 1e-6)
    minor = np.abs(su * tv - sv * tu) / major
    fine = np.maximum(np.maximum(minor, major / quality.probes), 1e-6)
    level = np.clip(np.log2(fine) + LEVEL_BIAS, 0, LEVELS - 1.001)
    axis_s, axis_t = np.where(long_is_u, su, sv), np.where(long_is_u, tu, tv)
    if not quality.blended:
        level = np.rint(level)
    colours = _filtered(scene, texture, place_s, place_t, level, axis_s, axis_t, major > 1.6 * fine, quality)
    u = hits.s * scene.light_scale[:, 0].take(surface) + scene.light_origin[:, 0].take(surface)
    v = hits.t * scene.light_scale[:, 1].take(surface) + scene.light_origin[:, 1].take(surface)
    return np.asarray(colours * _look_up(scene.light, u, v))


def _filtered(
    scene: Scene,
    texture: Ints,
    s: Floats,
    t: Floats,
    level: Floats,
    axis_s: Floats,
    axis_t: Floats,
    is_long: NDArray[np.bool_],
    quality: Quality,
) -> Floats:
    """Blend two mipmap levels; where a footprint is long, average several places along it."""
    colours = np.empty((len(s), 3), np.float32)
    spread = tuple((np.arange(quality.probes) + 0.5) / quality.probes - 0.5)
    for chosen, offsets in ((~is_long, (0.0,)), (is_long, spread)):
        rows = np.flatnonzero(chosen)
        if len(rows) == 0:
            continue
        tex, lod = texture[rows], level[rows]
        size = scene.atlas_size[tex * LEVELS]
        periodic = scene.periodic[tex]
        low = lod.astype(np.int32)
        blend = (lod - low)[:, None]
        total = np.zeros((len(rows), 3), np.float32)
        for offset in offsets:
            place_s = _wrapped(s[rows] + np.float32(offset) * axis_s[rows], size[:, 0], periodic)
            place_t = _wrapped(t[rows] + np.float32(offset) * axis_t[rows], size[:, 1], periodic)
            near = _sample(scene, tex, place_s, place_t, low)
            total += near
            if quality.blended:
                total += (_sample(scene, tex, place_s, place_t, low + 1) - near) * blend
        colours[rows] = total / len(offsets)
    return colours


def _shared_pixels(view: _View, surface: Ints, shape: tuple[int, int]) -> NDArray[np.int64]:
    """Return the flat indices of pixels next to another plane, whose colour is a mixture."""
    plane = np.append(view.scene.plane, -1)[surface].reshape(shape)
    edge = np.zeros(shape, np.bool_)
    beside, below = plane[:, 1:] != plane[:, :-1], plane[1:] != plane[:-1]
    edge[:, 1:] |= beside
    edge[:, :-1] |= beside
    edge[1:] |= below
    edge[:-1] |= below
    return np.flatnonzero(edge)


def _smoothed(view: _View, rays: _Rays, pixels: NDArray[np.int64]) -> Floats:
    """Return the colours (n, 3) of pixels as the mean over several rays each."""
    x, y, step_x, step_y = (a[pixels] for a in (rays.x, rays.y, rays.step_x, rays.step_y))
    finer = [
        (x + np.float32(dx) * step_x, y + np.float32(dy) * step_y, step_x * 0.7, step_y * 0.7)
        for dx, dy in EDGE_OFFSETS_PX
    ]
    bundle = _Rays(*(np.concatenate(parts).astype(np.float32) for parts in zip(*finer, strict=True)))
    colours = _colours(view, _cast(view, bundle.x, bundle.y), bundle, FINE)[0]
    return np.asarray(colours.reshape(len(EDGE_OFFSETS_PX), -1, 3).mean(axis=0))


def _colours(view: _View, surface: Ints, rays: _Rays, quality: Quality) -> tuple[Floats, Floats]:
    """Return colours (n, 3) and depths (n,) of rays whose rectangles are known; black and 0 where there is
    none."""
    hits = _intersect(view, np.maximum(surface, 0), rays)
    missed = surface < 0
    colours, depth = _shade(view.scene, hits, quality), hits.depth
    if missed.any():
        colours[missed], depth[missed] = 0, 0
    return colours, depth


def render(
    scene: Scene, camera: Camera, world_from_camera: Pose, quality: Quality = FINE
) -> tuple[NDArray[np.uint8], Floats]:
    """Return what a camera sees: RGB (h, w, 3) uint8 and exact z-depth (h, w) float32 in metres, 0 for no
    surface."""
    view, rays = _view(scene, world_from_camera), camera_rays(camera)
    shape = (camera.height, camera.width)
    surface = _cast(view, rays.x, rays.y) if quality.every_ray else _cast_where_needed(view, rays, shape)
    colours, depth = _colours(view, surface, rays, quality)
    shared = _shared_pixels(view, surface, shape) if quality.smooth else np.zeros(0, np.int64)
    if len(shared):
        colours[shared] = _smoothed(view, rays, shared)
    rgb = np.clip(colours + 0.5, 0, 255).astype(np.uint8).reshape(*shape, 3)
    return rgb, depth.reshape(shape)
