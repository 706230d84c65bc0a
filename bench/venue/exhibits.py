"""Exhibits as groups of boxes: pedestals, glass cases, exhibition walls and easels, in their own axes."""

from __future__ import annotations

from bench.render.atlas import Texture
from bench.render.noise import seeded
from bench.render.surfaces import Box

Size = tuple[float, float, float]


def picture(kind: str, seed: int, text: str = "") -> Texture:
    """Return a print whose size the box's face will set."""
    return Texture(kind, seed, text=text)


def pedestal(size: Size, seed: int) -> list[Box]:
    """Return blocks piled on a pedestal with a plate."""
    w, d, h = size
    rng = seeded("pedestal", seed)
    found = [
        Box(
            centre=(0, 0),
            base_m=0,
            size_m=(w, d, h * 0.62),
            material="plain_white",
            front=picture("plate", seed),
        )
    ]
    base, side = h * 0.62, w * 0.7
    for _ in range(4):
        tall = float(rng.uniform(0.12, 0.32))
        material = str(rng.choice(["metal", "wood_dark", "brick_red", "stone_check", "fabric_red", "leaves"]))
        found.append(
            Box(
                centre=(0, 0),
                base_m=base,
                size_m=(side, side, tall),
                yaw_deg=float(rng.uniform(0, 90)),
                material=material,
            )
        )
        base, side = base + tall, side * float(rng.uniform(0.6, 1.05))
    return found


def vitrine(size: Size, seed: int) -> list[Box]:
    """Return a glass case with things under its top."""
    w, d, h = size
    rng = seeded("vitrine", seed)
    things = [
        Box(
            centre=(float(rng.uniform(-0.4, 0.4) * w), float(rng.uniform(-0.3, 0.3) * d)),
            base_m=h,
            size_m=(
                float(rng.uniform(0.06, 0.2)),
                float(rng.uniform(0.06, 0.2)),
                float(rng.uniform(0.04, 0.3)),
            ),
            yaw_deg=float(rng.uniform(0, 90)),
            material=str(rng.choice(["metal", "brick_red", "wood_dark", "fabric_blue"])),
            is_obstacle=False,
        )
        for _ in range(7)
    ]
    return [
        Box(
            centre=(0, 0),
            base_m=0,
            size_m=size,
            material="wood_dark",
            front=picture("plate", seed),
            top=picture("noticeboard", seed),
        ),
        *things,
    ]


def panel(size: Size, seed: int) -> list[Box]:
    """Return a free-standing exhibition wall with a picture on each side."""
    w, d, h = size
    hung = (w * 0.75, 0.03, h * 0.55)
    return [
        Box(centre=(0, 0), base_m=0, size_m=size, material="plaster_white"),
        Box(
            centre=(0, -d / 2 - 0.016),
            base_m=0.85,
            size_m=hung,
            yaw_deg=0,
            material="wood_dark",
            front=picture("painting", 900 + seed),
        ),
        Box(
            centre=(0, d / 2 + 0.016),
            base_m=0.85,
            size_m=hung,
            yaw_deg=180,
            material="wood_dark",
            front=picture("painting", 950 + seed),
        ),
    ]


def easel(size: Size, seed: int) -> list[Box]:
    """Return a poster, printed on both sides, on a stand."""
    w, d, h = size
    poster = picture("poster", 300 + seed)
    return [
        Box(
            centre=(0, 0),
            base_m=0.5,
            size_m=(w, 0.04, h - 0.5),
            yaw_deg=0,
            material="wood_dark",
            front=poster,
            back=picture("poster", 350 + seed),
        ),
        Box(centre=(0, 0), base_m=0, size_m=(w, d, 0.05), material="metal"),
        Box(centre=(0, 0), base_m=0.05, size_m=(0.06, 0.04, 0.45), material="metal"),
    ]
