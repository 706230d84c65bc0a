"""Pieces of furniture as groups of boxes, built in the piece's own axes: front towards -y, base at 0."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from bench.render.atlas import Texture
from bench.render.noise import seeded
from bench.render.surfaces import Box

Size = tuple[float, float, float]
Builder = Callable[[Size, int], list[Box]]


@dataclass(frozen=True, slots=True)
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


def _picture(kind: str, seed: int, text: str = "") -> Texture:
    """Return a print whose size the box's face will set."""
    return Texture(kind, seed, text=text)


def _wood(seed: int) -> str:
    return "wood_light" if seed % 2 else "wood_dark"


def _fabric(seed: int) -> str:
    return ("fabric_blue", "fabric_red", "fabric_grey")[seed % 3]


def _legs(w: float, d: float, h: float, thick: float, material: str) -> list[Box]:
    x, y = w / 2 - thick, d / 2 - thick
    return [
        Box((sx * x, sy * y), 0, (thick, thick, h), material=material, is_obstacle=False)
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
                at,
                h,
                (0.22, 0.30, 0.01),
                float(rng.uniform(0, 360)),
                "plain_white",
                top=sheet,
                is_obstacle=False,
            )
        )
    return [
        Box((0, 0), h - 0.04, (w, d, 0.04), material=_wood(seed)),
        *_legs(w, d, h - 0.04, 0.06, "metal"),
        *papers,
    ]


def _chair(size: Size, seed: int) -> list[Box]:
    w, d, h = size
    fabric = _fabric(seed)
    return [
        Box((0, 0), 0.42, (w, d, 0.06), material=fabric),
        Box((0, d / 2 - 0.02), 0.55, (w, 0.04, h - 0.55), material=fabric),
        *_legs(w, d, h - 0.02, 0.035, "metal")[1::2],
        *_legs(w, d, 0.42, 0.035, "metal")[::2],
    ]


def _bench(size: Size, seed: int) -> list[Box]:
    w, d, h = size
    feet = [Box((s * (w / 2 - 0.2), 0), 0, (0.12, d * 0.8, h - 0.07), material="metal") for s in (-1, 1)]
    return [Box((0, 0), h - 0.07, (w, d, 0.07), material=_wood(seed)), *feet]


def _sofa(size: Size, seed: int) -> list[Box]:
    w, d, h = size
    fabric = _fabric(seed)
    return [
        Box((0, 0), 0.08, (w, d, 0.34), material=fabric),
        Box((0, d / 2 - 0.1), 0.42, (w, 0.2, h - 0.42), material=fabric),
        *(Box((s * (w / 2 - 0.08), -0.05), 0.42, (0.16, d - 0.1, 0.18), material=fabric) for s in (-1, 1)),
        Box((-w / 4, 0.05), 0.42, (0.4, 0.12, 0.36), 8, _fabric(seed + 1), is_obstacle=False),
    ]


def _bookcase(size: Size, seed: int) -> list[Box]:
    front = _picture("books", seed)
    return [Box((0, 0), 0, size, material="wood_dark", front=front, back=_picture("books", seed + 500))]


def _cabinet(size: Size, seed: int) -> list[Box]:
    return [Box((0, 0), 0, size, material=_wood(seed), front=_picture("drawers", seed))]


def _counter(size: Size, seed: int) -> list[Box]:
    w, d, h = size
    return [
        Box((0, 0), 0, (w, d, h - 0.05), material="wood_panel"),
        Box((0, 0), h - 0.05, (w + 0.1, d + 0.1, 0.05), material="stone_tile"),
        Box(
            (w * 0.25, 0.1),
            h,
            (0.5, 0.06, 0.36),
            180,
            "plain_dark",
            _picture("screen", seed),
            is_obstacle=False,
        ),
        Box(
            (-w * 0.3, 0),
            h,
            (0.30, 0.22, 0.16),
            20,
            "plain_white",
            _picture("plate", seed, "INFO"),
            is_obstacle=False,
        ),
    ]


def _pedestal(size: Size, seed: int) -> list[Box]:
    w, d, h = size
    rng = seeded("pedestal", seed)
    found = [Box((0, 0), 0, (w, d, h * 0.62), material="plain_white", front=_picture("plate", seed))]
    base, side = h * 0.62, w * 0.7
    for _ in range(4):
        tall = float(rng.uniform(0.12, 0.32))
        material = str(rng.choice(["metal", "wood_dark", "brick_red", "stone_check", "fabric_red", "leaves"]))
        found.append(Box((0, 0), base, (side, side, tall), float(rng.uniform(0, 90)), material))
        base, side = base + tall, side * float(rng.uniform(0.6, 1.05))
    return found


def _vitrine(size: Size, seed: int) -> list[Box]:
    w, d, h = size
    rng = seeded("vitrine", seed)
    things = [
        Box(
            (float(rng.uniform(-0.4, 0.4) * w), float(rng.uniform(-0.3, 0.3) * d)),
            h,
            (float(rng.uniform(0.06, 0.2)), float(rng.uniform(0.06, 0.2)), float(rng.uniform(0.04, 0.3))),
            float(rng.uniform(0, 90)),
            str(rng.choice(["metal", "brick_red", "wood_dark", "fabric_blue"])),
            is_obstacle=False,
        )
        for _ in range(7)
    ]
    return [
        Box(
            (0, 0),
            0,
            size,
            material="wood_dark",
            front=_picture("plate", seed),
            top=_picture("noticeboard", seed),
        ),
        *things,
    ]


def _plant(size: Size, seed: int) -> list[Box]:
    w, _, h = size
    rng = seeded("plant", seed)
    found = [Box((0, 0), 0, (w, w, 0.42), material=("brick_red", "concrete")[seed % 2])]
    for _ in range(9):
        at = (float(rng.normal(0, 0.1)), float(rng.normal(0, 0.1)))
        side = float(rng.uniform(0.18, 0.36))
        found.append(
            Box(
                at,
                float(rng.uniform(0.42, h - side)),
                (side, side, side),
                float(rng.uniform(0, 90)),
                "leaves",
            )
        )
    return found


def _desk(size: Size, seed: int) -> list[Box]:
    w, d, h = size
    return [
        *_table(size, seed),
        Box(
            (w / 2 - 0.25, 0), 0, (0.4, d - 0.1, h - 0.06), material="metal", front=_picture("drawers", seed)
        ),
        Box(
            (-0.1, 0.15),
            h + 0.1,
            (0.55, 0.05, 0.34),
            6,
            "plain_dark",
            _picture("screen", seed),
            is_obstacle=False,
        ),
        Box((-0.1, 0.15), h, (0.12, 0.12, 0.1), material="plain_dark", is_obstacle=False),
        Box(
            (-w / 2 + 0.3, 0.1),
            h,
            (0.3, 0.2, 0.18),
            15,
            "fabric_grey",
            _picture("books", seed),
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
                    at,
                    base,
                    (w / columns * 0.92, d * float(rng.uniform(0.8, 1)), tall),
                    float(rng.normal(0, 4)),
                    "fabric_grey",
                    side,
                    side,
                    side,
                )
            )
            base += tall
    return found


def _rack(size: Size, seed: int) -> list[Box]:
    w, d, h = size
    found = _legs(w, d, h, 0.05, "metal")
    for k in range(3):
        level = 0.15 + k * (h - 0.35) / 2
        found.append(Box((0, 0), level, (w, d, 0.04), material="metal"))
        goods = _cartons((w * 0.94, d * 0.8, min(0.5, (h - 0.35) / 2 - 0.1)), seed * 3 + k)
        found += [replace(box, base_m=box.base_m + level + 0.04) for box in goods]
    return found


def _bed(size: Size, seed: int) -> list[Box]:
    w, d, h = size
    return [
        Box(
            (0, 0),
            0.3,
            (w, d, h - 0.3),
            material="plain_white",
            front=_picture("plate", seed, f"BED {seed}"),
            top=Texture(_fabric(seed)),
        ),
        Box((0, d / 2 - 0.25), h, (w * 0.7, 0.35, 0.12), material="plain_white", is_obstacle=False),
        Box((0, d / 2), 0, (w, 0.05, h + 0.4), material=_wood(seed)),
        *_legs(w, d, 0.3, 0.05, "metal"),
    ]


def _panel(size: Size, seed: int) -> list[Box]:
    """A free-standing exhibition wall with a picture on each side."""
    w, d, h = size
    hung = (w * 0.75, 0.03, h * 0.55)
    return [
        Box((0, 0), 0, size, material="plaster_white"),
        Box((0, -d / 2 - 0.016), 0.85, hung, 0, "wood_dark", _picture("painting", 900 + seed)),
        Box((0, d / 2 + 0.016), 0.85, hung, 180, "wood_dark", _picture("painting", 950 + seed)),
    ]


def _column(size: Size, seed: int) -> list[Box]:
    return [Box((0, 0), 0, size, material=("brick_white", "concrete", "stone_tile")[seed % 3])]


def _vending(size: Size, seed: int) -> list[Box]:
    return [Box((0, 0), 0, size, material="metal", front=_picture("vending", seed))]


def _easel(size: Size, seed: int) -> list[Box]:
    w, d, h = size
    poster = _picture("poster", 300 + seed)
    return [
        Box((0, 0), 0.5, (w, 0.04, h - 0.5), 0, "wood_dark", poster, _picture("poster", 350 + seed)),
        Box((0, 0), 0, (w, d, 0.05), material="metal"),
        Box((0, 0), 0.05, (0.06, 0.04, 0.45), material="metal"),
    ]


# kind -> (builder, the size it has when none is given)
BUILDERS: dict[str, tuple[Builder, Size]] = {
    "table": (_table, (1.4, 0.8, 0.74)),
    "chair": (_chair, (0.44, 0.44, 0.88)),
    "bench": (_bench, (1.8, 0.45, 0.45)),
    "sofa": (_sofa, (1.9, 0.85, 0.8)),
    "bookcase": (_bookcase, (1.6, 0.35, 2.0)),
    "cabinet": (_cabinet, (1.2, 0.45, 1.1)),
    "counter": (_counter, (3.0, 0.7, 1.08)),
    "pedestal": (_pedestal, (0.55, 0.55, 1.5)),
    "vitrine": (_vitrine, (1.4, 0.7, 0.95)),
    "plant": (_plant, (0.42, 0.42, 1.6)),
    "desk": (_desk, (1.5, 0.75, 0.74)),
    "cartons": (_cartons, (1.6, 0.5, 1.4)),
    "rack": (_rack, (2.0, 0.6, 2.0)),
    "bed": (_bed, (0.95, 2.0, 0.6)),
    "panel": (_panel, (2.4, 0.18, 2.2)),
    "column": (_column, (0.5, 0.5, 2.9)),
    "vending": (_vending, (0.95, 0.8, 1.85)),
    "easel": (_easel, (0.8, 0.5, 1.6)),
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
