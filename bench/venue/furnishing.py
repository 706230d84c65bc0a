"""Which furniture stands where: per room, in metres from the room's south-west inner corner."""

from __future__ import annotations

from bench.venue.furniture import Item


def _dining(x: float, y: float, seed: int, yaw: float = 0.0) -> list[Item]:
    """Return a small table with two chairs, at an angle."""
    return [
        Item(kind="table", x=x, y=y, yaw_deg=yaw, size_m=(0.8, 0.8, 0.74), seed=seed),
        Item(kind="chair", x=x + 0.1, y=y - 0.68, yaw_deg=yaw + 180, seed=seed + 1),
        Item(kind="chair", x=x - 0.08, y=y + 0.7, yaw_deg=yaw + 8, seed=seed + 2),
    ]


def _workplace(x: float, y: float, yaw: float, seed: int) -> list[Item]:
    """Return a desk; its chair stands in front (towards the desk's -y)."""
    dx, dy = {0: (0.0, -0.7), 90: (0.7, 0.0), 180: (0.0, 0.7), 270: (-0.7, 0.0)}[int(yaw)]
    return [
        Item(kind="desk", x=x, y=y, yaw_deg=yaw, seed=seed),
        Item(kind="chair", x=x + dx, y=y + dy, yaw_deg=yaw + 170, seed=seed),
    ]


def _seats(x: float, y: float, rows: int, columns: int, seed: int) -> list[Item]:
    return [
        Item(kind="chair", x=x + 0.75 * i, y=y - 1.1 * j, yaw_deg=180.0, seed=seed + (i + j) % 3)
        for i in range(columns)
        for j in range(rows)
    ]


FURNITURE: dict[str, tuple[Item, ...]] = {
    "0-reception": (
        Item(kind="counter", x=7.6, y=5.4, yaw_deg=90, seed=1),
        Item(kind="bookcase", x=9.55, y=6.9, yaw_deg=-90, size_m=(1.4, 0.35, 2.0), seed=3),
        Item(kind="sofa", x=1.0, y=1.2, yaw_deg=90, seed=1),
        Item(kind="table", x=2.6, y=1.3, yaw_deg=0, size_m=(0.9, 0.6, 0.45), seed=5),
        Item(kind="plant", x=0.5, y=7.2, seed=2),
        Item(kind="plant", x=9.2, y=0.5, seed=3),
        Item(kind="easel", x=5.6, y=6.6, yaw_deg=35, seed=1),
        Item(kind="column", x=4.9, y=3.6, yaw_deg=20, seed=0),
        Item(kind="vitrine", x=6.3, y=1.6, yaw_deg=15, seed=2),
    ),
    "0-gallery-a": (
        Item(kind="panel", x=4.6, y=6.1, yaw_deg=20, seed=1),
        Item(kind="pedestal", x=2.0, y=3.4, yaw_deg=12, seed=1),
        Item(kind="pedestal", x=7.9, y=2.4, yaw_deg=40, seed=2),
        Item(kind="bench", x=5.2, y=3.6, yaw_deg=80, seed=1),
        Item(kind="vitrine", x=1.2, y=7.6, yaw_deg=95, seed=4),
        Item(kind="plant", x=9.3, y=8.2, seed=4),
    ),
    "0-gallery-b": (
        Item(kind="panel", x=3.2, y=4.6, yaw_deg=90, seed=3),
        Item(kind="panel", x=6.6, y=3.4, yaw_deg=15, seed=4),
        Item(kind="pedestal", x=5.0, y=6.6, yaw_deg=5, seed=5),
        Item(kind="pedestal", x=1.2, y=1.4, yaw_deg=50, seed=6),
        Item(kind="bench", x=8.0, y=6.9, yaw_deg=10, seed=2),
        Item(kind="vitrine", x=1.4, y=7.4, yaw_deg=0, seed=7),
    ),
    "0-gallery-c": (
        Item(kind="panel", x=3.6, y=4.9, yaw_deg=-15, seed=6),
        Item(kind="panel", x=7.6, y=5.6, yaw_deg=70, seed=7),
        Item(kind="vitrine", x=5.6, y=2.2, yaw_deg=30, seed=8),
        Item(kind="pedestal", x=9.4, y=2.0, yaw_deg=20, seed=8),
        Item(kind="pedestal", x=1.6, y=7.2, yaw_deg=65, seed=9),
        Item(kind="bench", x=5.4, y=7.2, yaw_deg=0, seed=3),
        Item(kind="cabinet", x=10.4, y=6.0, yaw_deg=-90, seed=3),
    ),
    "0-hall": (
        Item(kind="column", x=2.8, y=2.4, yaw_deg=0, seed=1),
        Item(kind="column", x=2.8, y=6.4, yaw_deg=0, seed=1),
        Item(kind="column", x=7.9, y=2.4, yaw_deg=0, seed=2),
        Item(kind="column", x=7.9, y=6.4, yaw_deg=0, seed=2),
        Item(kind="vitrine", x=5.4, y=4.4, yaw_deg=25, size_m=(1.8, 0.9, 0.95), seed=11),
        Item(kind="sofa", x=0.6, y=7.6, yaw_deg=90, seed=2),
        Item(kind="plant", x=0.5, y=0.6, seed=5),
        Item(kind="easel", x=10.0, y=6.8, yaw_deg=-60, seed=3),
        Item(kind="bench", x=6.4, y=0.4, yaw_deg=180, seed=4),
        Item(kind="cabinet", x=9.8, y=8.5, yaw_deg=0, seed=5),
    ),
    "0-cafe": (
        Item(kind="counter", x=5.3, y=2.2, yaw_deg=-90, size_m=(3.2, 0.7, 1.08), seed=4),
        Item(kind="vending", x=6.8, y=5.4, yaw_deg=-90, seed=1),
        Item(kind="bookcase", x=6.7, y=7.0, yaw_deg=-90, size_m=(1.0, 0.35, 1.9), seed=17),
        *_dining(1.4, 1.7, 1, 12),
        *_dining(3.2, 3.2, 4, -20),
        *_dining(1.3, 3.9, 7, 30),
        Item(kind="plant", x=0.5, y=7.2, seed=6),
    ),
    "0-restrooms": (
        Item(kind="cabinet", x=0.45, y=2.0, yaw_deg=90, size_m=(1.8, 0.5, 0.85), seed=9),
        Item(kind="panel", x=2.3, y=3.0, yaw_deg=90, size_m=(2.6, 0.08, 2.0), seed=21),
    ),
    "0-lobby": (
        Item(kind="sofa", x=0.6, y=13.8, yaw_deg=90, seed=4),
        Item(kind="plant", x=3.4, y=10.4, seed=7),
        Item(kind="vending", x=0.6, y=3.2, yaw_deg=90, seed=5),
        Item(kind="easel", x=2.6, y=8.6, yaw_deg=75, seed=6),
    ),
    "0-strip-sw": (
        Item(kind="table", x=4.0, y=1.2, yaw_deg=0, size_m=(2.4, 0.9, 0.9), seed=13),
        Item(kind="table", x=8.0, y=1.2, yaw_deg=0, size_m=(2.4, 0.9, 0.9), seed=14),
        Item(kind="rack", x=2.4, y=4.4, yaw_deg=0, seed=1),
        Item(kind="rack", x=5.4, y=4.4, yaw_deg=0, seed=2),
        Item(kind="cabinet", x=0.35, y=2.4, yaw_deg=90, seed=11),
        Item(kind="cartons", x=10.6, y=0.5, yaw_deg=180, seed=1),
    ),
    "0-strip-se": (
        Item(kind="rack", x=2.0, y=0.5, yaw_deg=180, seed=3),
        Item(kind="rack", x=4.6, y=0.5, yaw_deg=180, seed=4),
        Item(kind="rack", x=7.2, y=0.5, yaw_deg=180, seed=5),
        Item(kind="rack", x=1.8, y=4.3, yaw_deg=0, seed=6),
        Item(kind="cartons", x=7.6, y=3.9, yaw_deg=-10, seed=7),
        Item(kind="cartons", x=3.4, y=2.5, yaw_deg=35, size_m=(1.2, 0.5, 1.0), seed=8),
    ),
    "0-room-1": (
        *_workplace(1.2, 4.4, 0, 1),
        *_workplace(5.2, 4.6, 0, 2),
        Item(kind="bookcase", x=0.3, y=2.4, yaw_deg=90, seed=21),
        Item(kind="plant", x=6.2, y=0.6, seed=8),
    ),
    "0-room-2": (
        *_workplace(2.2, 4.6, 0, 5),
        *_workplace(5.0, 1.4, 180, 6),
        Item(kind="cabinet", x=6.4, y=4.6, yaw_deg=-90, seed=13),
    ),
    "0-room-3": (
        *_workplace(1.2, 1.4, 180, 9),
        *_workplace(4.6, 1.4, 180, 10),
        Item(kind="bookcase", x=3.2, y=5.2, yaw_deg=0, seed=25),
        Item(kind="cabinet", x=5.4, y=5.2, yaw_deg=0, seed=15),
    ),
    "0-room-4": (
        *_workplace(5.0, 4.4, 0, 12),
        Item(kind="cartons", x=6.2, y=2.4, yaw_deg=-90, seed=11),
        Item(kind="table", x=2.4, y=2.2, yaw_deg=20, seed=15),
    ),
    "0-strip-nw": (
        Item(kind="table", x=3.6, y=2.3, yaw_deg=0, size_m=(3.0, 1.0, 0.9), seed=16),
        Item(kind="table", x=8.4, y=2.3, yaw_deg=0, size_m=(3.0, 1.0, 0.9), seed=17),
        Item(kind="cabinet", x=1.0, y=4.3, yaw_deg=0, seed=17),
        Item(kind="rack", x=13.2, y=4.2, yaw_deg=0, seed=9),
        Item(kind="cabinet", x=7.0, y=4.3, yaw_deg=0, size_m=(2.0, 0.45, 1.1), seed=18),
    ),
    "0-strip-ne": (
        Item(kind="bookcase", x=2.0, y=1.0, yaw_deg=0, seed=31),
        Item(kind="bookcase", x=4.0, y=1.0, yaw_deg=0, seed=32),
        Item(kind="bookcase", x=2.0, y=3.6, yaw_deg=0, seed=33),
        Item(kind="bookcase", x=4.0, y=3.6, yaw_deg=0, seed=34),
        Item(kind="cartons", x=5.9, y=2.6, yaw_deg=-90, seed=13),
    ),
    "1-library": (
        *(
            Item(
                kind="bookcase",
                x=2.6 + 2.2 * (k % 2),
                y=2.6 + 2.4 * (k // 2),
                yaw_deg=90 * 0,
                size_m=(2.0, 0.4, 2.0),
                seed=41 + k,
            )
            for k in range(6)
        ),
        Item(kind="counter", x=8.2, y=8.4, yaw_deg=-60, seed=21),
        *_workplace(1.2, 10.8, 90, 21),
        Item(kind="sofa", x=8.4, y=1.0, yaw_deg=180, seed=7),
        Item(kind="plant", x=0.5, y=0.5, seed=9),
    ),
    "1-lecture": (
        *_seats(2.4, 7.6, 5, 8, 2),
        Item(kind="counter", x=3.2, y=11.2, yaw_deg=0, size_m=(1.4, 0.6, 1.1), seed=23),
        Item(kind="easel", x=6.8, y=11.4, yaw_deg=10, seed=9),
    ),
    "1-gallery-d": (
        Item(kind="panel", x=4.2, y=4.0, yaw_deg=25, seed=11),
        Item(kind="panel", x=7.6, y=5.4, yaw_deg=-40, seed=12),
        Item(kind="pedestal", x=2.0, y=6.6, yaw_deg=8, seed=12),
        Item(kind="pedestal", x=9.2, y=2.2, yaw_deg=33, seed=13),
        Item(kind="bench", x=5.6, y=7.2, yaw_deg=0, seed=7),
    ),
    "1-hall": (
        Item(kind="column", x=2.8, y=2.4, yaw_deg=45, seed=0),
        Item(kind="column", x=7.9, y=6.2, yaw_deg=45, seed=0),
        Item(kind="table", x=5.4, y=4.6, yaw_deg=0, size_m=(2.6, 1.0, 0.74), seed=31),
        Item(kind="bookcase", x=10.5, y=7.4, yaw_deg=-90, seed=51),
        Item(kind="sofa", x=0.6, y=6.4, yaw_deg=90, seed=8),
        Item(kind="plant", x=10.2, y=0.6, seed=10),
    ),
    "1-members": (
        Item(kind="sofa", x=1.6, y=1.2, yaw_deg=180, seed=11),
        Item(kind="sofa", x=5.4, y=4.2, yaw_deg=-90, seed=12),
        Item(kind="table", x=3.4, y=3.6, yaw_deg=10, size_m=(1.1, 0.7, 0.45), seed=33),
        Item(kind="cabinet", x=6.8, y=6.8, yaw_deg=-90, seed=21),
        Item(kind="bookcase", x=3.6, y=0.3, yaw_deg=180, size_m=(1.2, 0.35, 1.9), seed=53),
    ),
    "1-restrooms": (
        Item(kind="cabinet", x=0.45, y=4.0, yaw_deg=90, size_m=(1.8, 0.5, 0.85), seed=23),
        Item(kind="panel", x=2.3, y=2.0, yaw_deg=90, size_m=(2.6, 0.08, 2.0), seed=25),
    ),
    "1-lobby": (
        Item(kind="bench", x=0.5, y=13.6, yaw_deg=90, seed=9),
        Item(kind="plant", x=3.4, y=8.6, seed=12),
        Item(kind="cabinet", x=0.4, y=3.2, yaw_deg=90, seed=25),
    ),
    "1-strip-sw": tuple(Item(kind="bed", x=1.6 + 2.3 * k, y=1.1, yaw_deg=180, seed=k + 1) for k in range(5)),
    "1-strip-se": (
        *(Item(kind="bed", x=1.6 + 2.3 * k, y=1.1, yaw_deg=180, seed=k + 11) for k in range(3)),
        Item(kind="cabinet", x=1.2, y=4.5, yaw_deg=0, seed=27),
    ),
    "1-room-1": (
        Item(kind="bed", x=1.0, y=4.4, yaw_deg=90, seed=21),
        *_workplace(5.4, 4.6, 0, 23),
        Item(kind="cabinet", x=6.4, y=1.4, yaw_deg=-90, seed=29),
    ),
    "1-room-2": (Item(kind="bed", x=5.4, y=4.4, yaw_deg=0, seed=22), *_workplace(2.0, 4.6, 0, 25)),
    "1-room-3": (
        Item(kind="bed", x=1.2, y=1.4, yaw_deg=0, seed=23),
        *_workplace(4.8, 1.4, 180, 27),
        Item(kind="plant", x=6.2, y=5.0, seed=14),
    ),
    "1-room-4": (
        Item(kind="bed", x=5.4, y=4.2, yaw_deg=0, seed=24),
        Item(kind="cabinet", x=1.4, y=0.4, yaw_deg=180, seed=31),
    ),
    "1-strip-nw": (
        *(Item(kind="bed", x=2.0 + 2.4 * k, y=3.4, yaw_deg=0, seed=k + 31) for k in range(4)),
        Item(kind="cabinet", x=13.0, y=4.3, yaw_deg=0, seed=33),
    ),
    "1-strip-ne": (
        Item(kind="rack", x=2.0, y=1.0, yaw_deg=0, seed=21),
        Item(kind="rack", x=4.4, y=3.6, yaw_deg=0, seed=22),
        Item(kind="cartons", x=5.8, y=1.6, yaw_deg=-90, seed=23),
    ),
}
