"""All textures with their mipmaps in one image, so that one `cv2.remap` call can look any of them up."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.render.materials import MATERIALS
from bench.render.noise import seeded
from bench.venue.prints import PRINTS

Bytes = NDArray[np.uint8]

LEVELS = 8
PADDING = 2
ATLAS_WIDTH = 16384
MATERIAL_TEXELS_PER_M = {1024: 250.0, 512: 400.0}
PRINT_TEXELS_PER_M = 340.0
# Prints that are far away (the world behind the windows) or seldom seen from near: texels may be larger.
COARSE_TEXELS_PER_M = {"outdoors": 24.0, "cardboard": 220.0, "drawers": 280.0}


@dataclass(frozen=True, slots=True)
class Texture:
    """What to draw: the name of a material (periodic) or print, a seed, and a print's size in metres and
    text."""

    kind: str
    seed: int = 0
    size_m: tuple[float, float] = (0.0, 0.0)
    text: str = ""

    @property
    def is_material(self) -> bool:
        """Whether the texture repeats without end."""
        return self.kind in MATERIALS


def draw(texture: Texture) -> Bytes:
    """Return a texture's full-size image (h, w, 3), RGB."""
    rng = seeded(texture.kind, texture.seed, texture.text)
    if texture.is_material:
        image = MATERIALS[texture.kind](rng)
    else:
        scale = COARSE_TEXELS_PER_M.get(texture.kind, PRINT_TEXELS_PER_M)
        width, height = (max(8, round(side * scale)) for side in texture.size_m)
        image = PRINTS[texture.kind](rng, width, height, texture.text)
    return np.clip(image, 0, 255).astype(np.uint8)


def mipmaps(image: Bytes) -> list[Bytes]:
    """Return `LEVELS` images, each half as large as the one before (at least one texel)."""
    levels = [image]
    while len(levels) < LEVELS:
        h, w = levels[-1].shape[:2]
        half = (max(1, w // 2), max(1, h // 2))
        levels.append(np.asarray(cv2.resize(levels[-1], half, interpolation=cv2.INTER_AREA), dtype=np.uint8))
    return levels


@dataclass(frozen=True, slots=True, kw_only=True)
class Atlas:
    """The image (h, w, 3) and, per texture and level, where it lies.

    `origin_px` (n, LEVELS, 2) is the first texel; `size_px` (n, LEVELS, 2) the width and height; `periodic`
    (n,) says which textures repeat; `texels_per_m` (n,) is 0 for prints, which fill their surface.
    """

    image: Bytes
    index: dict[Texture, int]
    origin_px: NDArray[np.float32]
    size_px: NDArray[np.float32]
    periodic: NDArray[np.bool_]
    texels_per_m: NDArray[np.float32]


def _shelves(tiles: list[Bytes]) -> tuple[list[tuple[int, int]], int]:
    """Return the left top corner of each tile, packed in rows of falling height, and the height of it all."""
    places = [(0, 0)] * len(tiles)
    x = y = row_height = 0
    for k in sorted(range(len(tiles)), key=lambda i: (-tiles[i].shape[0], i)):
        h, w = tiles[k].shape[:2]
        if x + w > ATLAS_WIDTH:
            x, y, row_height = 0, y + row_height, 0
        places[k] = (x, y)
        x, row_height = x + w, max(row_height, h)
    return places, y + row_height


def build_atlas(textures: list[Texture]) -> Atlas:
    """Draw and pack textures, each with a border, wrapped (materials) or repeated (prints), against
    bleeding."""
    tiles: list[Bytes] = []
    for texture in textures:
        border = cv2.BORDER_WRAP if texture.is_material else cv2.BORDER_REPLICATE
        p = PADDING
        tiles += [
            np.asarray(cv2.copyMakeBorder(m, p, p, p, p, border), np.uint8) for m in mipmaps(draw(texture))
        ]
    places, height = _shelves(tiles)
    image = np.zeros((height, ATLAS_WIDTH, 3), np.uint8)
    for tile, (x, y) in zip(tiles, places, strict=True):
        image[y : y + tile.shape[0], x : x + tile.shape[1]] = tile
    shape = (len(textures), LEVELS, 2)
    sizes = np.array(
        [(t.shape[1] - 2 * PADDING, t.shape[0] - 2 * PADDING) for t in tiles], np.float32
    ).reshape(shape)
    return Atlas(
        image=image,
        index={texture: k for k, texture in enumerate(textures)},
        origin_px=(np.array(places, np.float32) + PADDING).reshape(shape),
        size_px=sizes,
        periodic=np.array([t.is_material for t in textures]),
        texels_per_m=np.array(
            [
                MATERIAL_TEXELS_PER_M[int(s[0, 0])] if t.is_material else 0.0
                for t, s in zip(textures, sizes, strict=True)
            ],
            np.float32,
        ),
    )
