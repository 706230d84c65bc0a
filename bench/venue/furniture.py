"""Pieces of furniture as groups of boxes, built in the piece's own axes: front towards -y, base at 0."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from bench.render.atlas import Texture
from bench.render.noise import seeded
from bench.render.surfaces import Box
from bench.venue.exhibits import Size, easel, panel, pedestal, picture, vitrine

Builder = Callable[[Size, int], list[Box]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Item:
    """A piece of furniture: kind, centre (metres from the room's south-west inner corner), yaw and size.

    A size of zeros takes the kind's own. `seed` picks its colours and prints.
    """

    kind: str
    x: float
    y: float
    yaw_deg: float = 0.0
    size_m: Size = (0.0, 0.0, 0.0)
    seed: int = 0


def _wood(seed: int) -> str:
    return "wood_light" if seed % 2 else "wood_dark"


def _fabric(seed: int) -> str:
    return ("fabric_blue", "fabric_red", "fabric_grey")[seed % 3]


def _legs(w: float, d: float, h: float, thick: float, material: str) -> list[Box]:
    x, y = w / 2 - thick, d / 2 - thick
    return [
        Box(centre=(sx * x, sy * y), base_m=0, size_m=(thick, thick, h), material=material, is_obstacle=False)
        for sx in (-1, 1)
        for sy in (-1, 1)
    ]


def _table(size: Size, seed: int) -> list[Box]:
    w, d, h = size
    papers = []
    rng = seeded("table", seed)
    for k in range(int(rng.integers(1, 4))):
        at = (float(rng.uniform(-0.3, 0.3) * w), float(rng.uniform(-0.25, 0.25) * d))
        sheet = Texture("plate" if k else "poster", seed * 7 + k)
        papers.append(
            Box(
                centre=at,
                base_m=h,
                size_m=(0.22, 0.30, 0.01),
                yaw_deg=float(rng.uniform(0, 360)),
                material="plain_white",
                top=sheet,
                is_obstacle=False,
            )
        )
    return [
        Box(centre=(0, 0), base_m=h - 0.04, size_m=(w, d, 0.04), material=_wood(seed)),
        *_legs(w, d, h - 0.04, 0.06, "metal"),
        *papers,
    ]


def _chair(size: Size, seed: int) -> list[Box]:
    w, d, h = size
    fabric = _fabric(seed)
    return [
        Box(centre=(0, 0), base_m=0.42, size_m=(w, d, 0.06), material=fabric),
        Box(centre=(0, d / 2 - 0.02), base_m=0.55, size_m=(w, 0.04, h - 0.55), material=fabric),
        *_legs(w, d, h - 0.02, 0.035, "metal")[1::2],
        *_legs(w, d, 0.42, 0.035, "metal")[::2],
    ]


def _bench(size: Size, seed: int) -> list[Box]:
    w, d, h = size
    feet = [
        Box(centre=(s * (w / 2 - 0.2), 0), base_m=0, size_m=(0.12, d * 0.8, h - 0.07), material="metal")
        for s in (-1, 1)
    ]
    return [Box(centre=(0, 0), base_m=h - 0.07, size_m=(w, d, 0.07), material=_wood(seed)), *feet]


def _sofa(size: Size, seed: int) -> list[Box]:
    w, d, h = size
    fabric = _fabric(seed)
    return [
        Box(centre=(0, 0), base_m=0.08, size_m=(w, d, 0.34), material=fabric),
        Box(centre=(0, d / 2 - 0.1), base_m=0.42, size_m=(w, 0.2, h - 0.42), material=fabric),
        *(
            Box(
                centre=(s * (w / 2 - 0.08), -0.05), base_m=0.42, size_m=(0.16, d - 0.1, 0.18), material=fabric
            )
            for s in (-1, 1)
        ),
        Box(
            centre=(-w / 4, 0.05),
            base_m=0.42,
            size_m=(0.4, 0.12, 0.36),
            yaw_deg=8,
            material=_fabric(seed + 1),
            is_obstacle=False,
        ),
    ]


def _bookcase(size: Size, seed: int) -> list[Box]:
    front = picture("books", seed)
    return [
        Box(
            centre=(0, 0),
            base_m=0,
            size_m=size,
            material="wood_dark",
            front=front,
            back=picture("books", seed + 500),
        )
    ]


def _cabinet(size: Size, seed: int) -> list[Box]:
    return [Box(centre=(0, 0), base_m=0, size_m=size, material=_wood(seed), front=picture("drawers", seed))]


def _counter(size: Size, seed: int) -> list[Box]:
    w, d, h = size
    return [
        Box(centre=(0, 0), base_m=0, size_m=(w, d, h - 0.05), material="wood_panel"),
        Box(centre=(0, 0), base_m=h - 0.05, size_m=(w + 0.1, d + 0.1, 0.05), material="stone_tile"),
        Box(
            centre=(w * 0.25, 0.1),
            base_m=h,
            size_m=(0.5, 0.06, 0.36),
            yaw_deg=180,
            material="plain_dark",
            front=picture("screen", seed),
            is_obstacle=False,
        ),
        Box(
            centre=(-w * 0.3, 0),
            base_m=h,
            size_m=(0.30, 0.22, 0.16),
            yaw_deg=20,
            material="plain_white",
            front=picture("plate", seed, "INFO"),
            is_obstacle=False,
        ),
    ]


def _plant(size: Size, seed: int) -> list[Box]:
    w, _, h = size
    rng = seeded("plant", seed)
    found = [Box(centre=(0, 0), base_m=0, size_m=(w, w, 0.42), material=("brick_red", "concrete")[seed % 2])]
    for _ in range(9):
        at = (float(rng.normal(0, 0.1)), float(rng.normal(0, 0.1)))
        side = float(rng.uniform(0.18, 0.36))
        found.append(
            Box(
                centre=at,
                base_m=float(rng.uniform(0.42, h - side)),
                size_m=(side, side, side),
                yaw_deg=float(rng.uniform(0, 90)),
                material="leaves",
            )
        )
    return found


def _desk(size: Size, seed: int) -> list[Box]:
    w, d, h = size
    return [
        *_table(size, seed),
        Box(
            centre=(w / 2 - 0.25, 0),
            base_m=0,
            size_m=(0.4, d - 0.1, h - 0.06),
            material="metal",
            front=picture("drawers", seed),
        ),
        Box(
            centre=(-0.1, 0.15),
            base_m=h + 0.1,
            size_m=(0.55, 0.05, 0.34),
            yaw_deg=6,
            material="plain_dark",
            front=picture("screen", seed),
            is_obstacle=False,
        ),
        Box(
            centre=(-0.1, 0.15), base_m=h, size_m=(0.12, 0.12, 0.1), material="plain_dark", is_obstacle=False
        ),
        Box(
            centre=(-w / 2 + 0.3, 0.1),
            base_m=h,
            size_m=(0.3, 0.2, 0.18),
            yaw_deg=15,
            material="fabric_grey",
            front=picture("books", seed),
            is_obstacle=False,
        ),
    ]


def _cartons(size: Size, seed: int) -> list[Box]:
    w, d, h = size
    rng = seeded("cartons", seed)
    found, columns = [], max(1, round(w / 0.55))
    for column in range(columns):
        base = 0.0
        while base < h - 0.2:
            tall = float(rng.uniform(0.25, 0.5))
            at = ((column + 0.5) * w / columns - w / 2, float(rng.normal(0, 0.03)))
            side = Texture("cardboard", int(rng.integers(0, 9)))
            found.append(
                Box(
                    centre=at,
                    base_m=base,
                    size_m=(w / columns * 0.92, d * float(rng.uniform(0.8, 1)), tall),
                    yaw_deg=float(rng.normal(0, 4)),
                    material="fabric_grey",
                    front=side,
                    back=side,
                    top=side,
                )
            )
            base += tall
    return found


def _rack(size: Size, seed: int) -> list[Box]:
    w, d, h = size
    found = _legs(w, d, h, 0.05, "metal")
    for k in range(3):
        level = 0.15 + k * (h - 0.35) / 2
        found.append(Box(centre=(0, 0), base_m=level, size_m=(w, d, 0.04), material="metal"))
        goods = _cartons((w * 0.94, d * 0.8, min(0.5, (h - 0.35) / 2 - 0.1)), seed * 3 + k)
        found += [replace(box, base_m=box.base_m + level + 0.04) for box in goods]
    return found


def _bed(size: Size, seed: int) -> list[Box]:
    w, d, h = size
    return [
        Box(
            centre=(0, 0),
            base_m=0.3,
            size_m=(w, d, h - 0.3),
            material="plain_white",
            front=picture("plate", seed, f"BED {seed}"),
            top=Texture(_fabric(seed)),
        ),
        Box(
            centre=(0, d / 2 - 0.25),
            base_m=h,
            size_m=(w * 0.7, 0.35, 0.12),
            material="plain_white",
            is_obstacle=False,
        ),
        Box(centre=(0, d / 2), base_m=0, size_m=(w, 0.05, h + 0.4), material=_wood(seed)),
        *_legs(w, d, 0.3, 0.05, "metal"),
    ]


def _column(size: Size, seed: int) -> list[Box]:
    return [
        Box(
            centre=(0, 0), base_m=0, size_m=size, material=("brick_white", "concrete", "stone_tile")[seed % 3]
        )
    ]


def _vending(size: Size, seed: int) -> list[Box]:
    return [Box(centre=(0, 0), base_m=0, size_m=size, material="metal", front=picture("vending", seed))]


# kind -> (builder, the size it has when none is given)
BUILDERS: dict[str, tuple[Builder, Size]] = {
    "table": (_table, (1.4, 0.8, 0.74)),
    "chair": (_chair, (0.44, 0.44, 0.88)),
    "bench": (_bench, (1.8, 0.45, 0.45)),
    "sofa": (_sofa, (1.9, 0.85, 0.8)),
    "bookcase": (_bookcase, (1.6, 0.35, 2.0)),
    "cabinet": (_cabinet, (1.2, 0.45, 1.1)),
    "counter": (_counter, (3.0, 0.7, 1.08)),
    "pedestal": (pedestal, (0.55, 0.55, 1.5)),
    "vitrine": (vitrine, (1.4, 0.7, 0.95)),
    "plant": (_plant, (0.42, 0.42, 1.6)),
    "desk": (_desk, (1.5, 0.75, 0.74)),
    "cartons": (_cartons, (1.6, 0.5, 1.4)),
    "rack": (_rack, (2.0, 0.6, 2.0)),
    "bed": (_bed, (0.95, 2.0, 0.6)),
    "panel": (panel, (2.4, 0.18, 2.2)),
    "column": (_column, (0.5, 0.5, 2.9)),
    "vending": (_vending, (0.95, 0.8, 1.85)),
    "easel": (easel, (0.8, 0.5, 1.6)),
}


def build(item: Item, corner_in_world: tuple[float, float], base_m: float) -> list[Box]:
    """Return an item's boxes in the world; `corner_in_world` is where the room's coordinates start."""
    builder, own = BUILDERS[item.kind]
    size: Size = item.size_m if any(item.size_m) else own
    c, s = np.cos(np.radians(item.yaw_deg)), np.sin(np.radians(item.yaw_deg))
    placed = []
    for box in builder(size, item.seed):
        x, y = box.centre
        centre = (
            corner_in_world[0] + item.x + float(c * x - s * y),
            corner_in_world[1] + item.y + float(s * x + c * y),
        )
        placed.append(
            replace(box, centre=centre, base_m=box.base_m + base_m, yaw_deg=box.yaw_deg + item.yaw_deg)
        )
    return placed
