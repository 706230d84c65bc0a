"""The building ready for rendering: rectangles as tables, textures in an atlas, baked light, an embree
tree."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.errors import RoomfixError
from bench.render.atlas import build_atlas
from bench.render.daylight import LAMPS_ALONE, Daylight
from bench.render.lighting import bake
from bench.render.noise import building
from bench.render.surfaces import Surface
from bench.venue.bare import bare_rooms
from bench.venue.building import shell
from bench.venue.decor import decoration, furniture

Floats = NDArray[np.float64]

# Raise it whenever a change makes the pictures differ: older renders are then not used any more.
SCENE_VERSION = 1

ARRAYS = (
    "corner",
    "right",
    "down",
    "plane",
    "texel_scale",
    "texel_offset",
    "texture",
    "light_scale",
    "light_origin",
    "atlas",
    "atlas_origin",
    "atlas_size",
    "periodic",
    "light",
)


class MissingRendererError(RoomfixError):
    """The optional package that casts the rays is not installed."""

    code = "missing_renderer"


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """n rectangles. `corner`, `right`, `down` (n, 3) in world metres; the front is where right x up points.

    A point s, t metres right and down of the corner has texel `texel_scale * (s, t) + texel_offset` on level
    0 of its `texture` and lies at `light_scale * (s, t) + light_origin` in the light image. `plane` (n,)
    numbers the planes of one texture. `atlas_*` are those of `atlas.Atlas`.
    """

    corner: Floats
    right: Floats
    down: Floats
    plane: NDArray[np.int32]
    texel_scale: NDArray[np.float32]
    texel_offset: NDArray[np.float32]
    texture: NDArray[np.int32]
    light_scale: NDArray[np.float32]
    light_origin: NDArray[np.float32]
    atlas: NDArray[np.uint8]
    atlas_origin: NDArray[np.float32]
    atlas_size: NDArray[np.float32]
    periodic: NDArray[np.bool_]
    light: NDArray[np.float32]
    embree: Any

    def save(self, directory: Path) -> None:
        """Write the arrays, for processes that `load` them."""
        directory.mkdir(parents=True, exist_ok=True)
        for name in ARRAYS:
            np.save(directory / f"{name}.npy", getattr(self, name))

    @staticmethod
    def load(directory: Path) -> Scene:
        """Return a saved scene; its memory is shared between all processes that have it open."""
        arrays = {name: np.load(directory / f"{name}.npy", mmap_mode="c") for name in ARRAYS}
        arrays = {name: np.asarray(array) for name, array in arrays.items()}
        return Scene(**arrays, embree=embree_scene(arrays["corner"], arrays["right"], arrays["down"]))


def embree_scene(corner: Floats, right: Floats, down: Floats) -> Any:
    """Return the ray-casting tree of rectangles (triangles 2k and 2k + 1 make up rectangle k).

    Raises `MissingRendererError` without embreex.
    """
    far = corner + right + down
    try:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene
    except ImportError:
        raise MissingRendererError(
            "Rendering the demonstration venue needs embreex: pip install -e '.[bench]' in a checkout."
        ) from None
    triangles = np.stack([corner, corner + down, far, corner, far, corner + right], axis=1).reshape(-1, 3, 3)
    scene = EmbreeScene()
    TriangleMesh(scene, np.ascontiguousarray(triangles, dtype=np.float32))
    return scene


def build_scene(surfaces: list[Surface], daylight: Daylight = LAMPS_ALONE) -> Scene:
    """Return the scene of surfaces, with textures drawn and light baked."""
    corner, right, down = (
        np.array([getattr(s, name) for s in surfaces]) for name in ("corner", "right", "down")
    )
    lengths = np.stack([np.linalg.norm(right, axis=1), np.linalg.norm(down, axis=1)], axis=1)
    normals = np.cross(down, right)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    embree = embree_scene(corner, right, down)
    light = bake(surfaces, normals, embree, daylight)
    atlas = build_atlas(sorted({s.texture for s in surfaces}, key=repr))
    texture = np.array([atlas.index[s.texture] for s in surfaces], np.int32)
    per_m = atlas.texels_per_m[texture][:, None]
    scale = np.where(per_m > 0, per_m, atlas.size_px[texture, 0] / lengths)
    planes: dict[str, int] = {}
    return Scene(
        corner=corner,
        right=right,
        down=down,
        plane=np.array(
            [planes.setdefault(s.plane or f"#{k}", len(planes)) for k, s in enumerate(surfaces)], np.int32
        ),
        texel_scale=scale.astype(np.float32),
        texel_offset=(np.array([s.offset_m for s in surfaces]) * per_m).astype(np.float32),
        texture=texture,
        light_scale=((light.nodes - 1) / lengths).astype(np.float32),
        light_origin=light.origin_px,
        atlas=atlas.image,
        atlas_origin=atlas.origin_px.reshape(-1, 2),
        atlas_size=atlas.size_px.reshape(-1, 2),
        periodic=atlas.periodic,
        light=light.image,
        embree=embree,
    )


@lru_cache(maxsize=1)
def demo_scene() -> Scene:
    """Return the demonstration building (about ten seconds the first time in a process)."""
    return build_scene(shell() + decoration())


@dataclass(frozen=True, slots=True)
class Building:
    """What is rendered. Each `number` has the demonstration's rooms and furniture, but other pictures, textures and
    stains, and corridors that look alike too; the demonstration has 0. A building that `is_bare` has white walls
    (`bench.venue.bare`), and furniture only where it `is_furnished`; others always have it. `daylight` is the time of
    day; by default the lamps alone give light.
    """

    number: int = 0
    is_bare: bool = False
    is_furnished: bool = False
    daylight: Daylight = LAMPS_ALONE

    @property
    def recipe(self) -> dict[str, Any]:
        """What is written beside pictures of it; nothing for the demonstration."""
        number = {"building": self.number} if self.number else {}
        bare = {"bare": True} if self.is_bare else {}
        furnished = {"furnished": True} if self.is_furnished else {}
        return {**number, **bare, **furnished, **self.daylight.recipe}


DEMONSTRATION = Building()


def scene_of(made: Building) -> Scene:
    """Return the scene of a building."""
    if made == DEMONSTRATION:
        return demo_scene()
    with building(made.number):
        if not made.is_bare:
            return build_scene(shell() + decoration(), made.daylight)
        return build_scene(bare_rooms() + (furniture() if made.is_furnished else []), made.daylight)


@lru_cache(maxsize=1)
def loaded_scene(directory: Path) -> Scene:
    """Return the scene another process saved."""
    return Scene.load(directory)
