"""Which furniture stands where: per room, in metres from the room's south-west inner corner."""

from __future__ import annotations

from bench.venue.furniture import Item


def _dining(x: float, y: float, seed: int, yaw: float = 0.0) -> list[Item]:
    """Return a small table with two chairs, at an angle."""
    return [
        Item("table", x, y, yaw, (0.8, 0.8, 0.74), seed),
        Item("chair", x + 0.1, y - 0.68, yaw + 180, seed=seed + 1),
        Item("chair", x - 0.08, y + 0.7, yaw + 8, seed=seed + 2),
    ]


def _workplace(x: float, y: float, yaw: float, seed: int) -> list[Item]:
    """Return a desk; its chair stands in front (towards the desk's -y)."""
    dx, dy = {0: (0.0, -0.7), 90: (0.7, 0.0), 180: (0.0, 0.7), 270: (-0.7, 0.0)}[int(yaw)]
    return [Item("desk", x, y, yaw, seed=seed), Item("chair", x + dx, y + dy, yaw + 170, seed=seed)]


def _seats(x: float, y: float, rows: int, columns: int, seed: int) -> list[Item]:
    return [
        Item("chair", x + 0.75 * i, y - 1.1 * j, 180.0, seed=seed + (i + j) % 3)
        for i in range(columns)
        for j in range(rows)
    ]


FURNITURE: dict[str, tuple[Item, ...]] = {
    "0-reception": (
        Item("counter", 7.6, 5.4, 90, seed=1),
        Item("bookcase", 9.55, 6.9, -90, (1.4, 0.35, 2.0), 3),
        Item("sofa", 1.0, 1.2, 90, seed=1),
        Item("table", 2.6, 1.3, 0, (0.9, 0.6, 0.45), 5),
        Item("plant", 0.5, 7.2, seed=2),
        Item("plant", 9.2, 0.5, seed=3),
        Item("easel", 5.6, 6.6, 35, seed=1),
        Item("column", 4.9, 3.6, 20, seed=0),
        Item("vitrine", 6.3, 1.6, 15, seed=2),
    ),
    "0-gallery-a": (
        Item("panel", 4.6, 6.1, 20, seed=1),
        Item("pedestal", 2.0, 3.4, 12, seed=1),
        Item("pedestal", 7.9, 2.4, 40, seed=2),
        Item("bench", 5.2, 3.6, 80, seed=1),
        Item("vitrine", 1.2, 7.6, 95, seed=4),
        Item("plant", 9.3, 8.2, seed=4),
    ),
    "0-gallery-b": (
        Item("panel", 3.2, 4.6, 90, seed=3),
        Item("panel", 6.6, 3.4, 15, seed=4),
        Item("pedestal", 5.0, 6.6, 5, seed=5),
        Item("pedestal", 1.2, 1.4, 50, seed=6),
        Item("bench", 8.0, 6.9, 10, seed=2),
        Item("vitrine", 1.4, 7.4, 0, seed=7),
    ),
    "0-gallery-c": (
        Item("panel", 3.6, 4.9, -15, seed=6),
        Item("panel", 7.6, 5.6, 70, seed=7),
        Item("vitrine", 5.6, 2.2, 30, seed=8),
        Item("pedestal", 9.4, 2.0, 20, seed=8),
        Item("pedestal", 1.6, 7.2, 65, seed=9),
        Item("bench", 5.4, 7.2, 0, seed=3),
        Item("cabinet", 10.4, 6.0, -90, seed=3),
    ),
    "0-hall": (
        Item("column", 2.8, 2.4, 0, seed=1),
        Item("column", 2.8, 6.4, 0, seed=1),
        Item("column", 7.9, 2.4, 0, seed=2),
        Item("column", 7.9, 6.4, 0, seed=2),
        Item("vitrine", 5.4, 4.4, 25, (1.8, 0.9, 0.95), 11),
        Item("sofa", 0.6, 7.6, 90, seed=2),
        Item("plant", 0.5, 0.6, seed=5),
        Item("easel", 10.0, 6.8, -60, seed=3),
        Item("bench", 6.4, 0.4, 180, seed=4),
        Item("cabinet", 9.8, 8.5, 0, seed=5),
    ),
    "0-cafe": (
        Item("counter", 5.3, 2.2, -90, (3.2, 0.7, 1.08), 4),
        Item("vending", 6.8, 5.4, -90, seed=1),
        Item("bookcase", 6.7, 7.0, -90, (1.0, 0.35, 1.9), 17),
        *_dining(1.4, 1.7, 1, 12),
        *_dining(3.2, 3.2, 4, -20),
        *_dining(1.3, 3.9, 7, 30),
        Item("plant", 0.5, 7.2, seed=6),
    ),
    "0-restrooms": (
        Item("cabinet", 0.45, 2.0, 90, (1.8, 0.5, 0.85), 9),
        Item("panel", 2.3, 3.0, 90, (2.6, 0.08, 2.0), 21),
    ),
    "0-lobby": (
        Item("sofa", 0.6, 13.8, 90, seed=4),
        Item("plant", 3.4, 10.4, seed=7),
        Item("vending", 0.6, 3.2, 90, seed=5),
        Item("easel", 2.6, 8.6, 75, seed=6),
    ),
    "0-strip-sw": (
        Item("table", 4.0, 1.2, 0, (2.4, 0.9, 0.9), 13),
        Item("table", 8.0, 1.2, 0, (2.4, 0.9, 0.9), 14),
        Item("rack", 2.4, 4.4, 0, seed=1),
        Item("rack", 5.4, 4.4, 0, seed=2),
        Item("cabinet", 0.35, 2.4, 90, seed=11),
        Item("cartons", 10.6, 0.5, 180, seed=1),
    ),
    "0-strip-se": (
        Item("rack", 2.0, 0.5, 180, seed=3),
        Item("rack", 4.6, 0.5, 180, seed=4),
        Item("rack", 7.2, 0.5, 180, seed=5),
        Item("rack", 1.8, 4.3, 0, seed=6),
        Item("cartons", 7.6, 3.9, -10, seed=7),
        Item("cartons", 3.4, 2.5, 35, (1.2, 0.5, 1.0), 8),
    ),
    "0-room-1": (
        *_workplace(1.2, 4.4, 0, 1),
        *_workplace(5.2, 4.6, 0, 2),
        Item("bookcase", 0.3, 2.4, 90, seed=21),
        Item("plant", 6.2, 0.6, seed=8),
    ),
    "0-room-2": (
        *_workplace(2.2, 4.6, 0, 5),
        *_workplace(5.0, 1.4, 180, 6),
        Item("cabinet", 6.4, 4.6, -90, seed=13),
    ),
    "0-room-3": (
        *_workplace(1.2, 1.4, 180, 9),
        *_workplace(4.6, 1.4, 180, 10),
        Item("bookcase", 3.2, 5.2, 0, seed=25),
        Item("cabinet", 5.4, 5.2, 0, seed=15),
    ),
    "0-room-4": (
        *_workplace(5.0, 4.4, 0, 12),
        Item("cartons", 6.2, 2.4, -90, seed=11),
        Item("table", 2.4, 2.2, 20, seed=15),
    ),
    "0-strip-nw": (
        Item("table", 3.6, 2.3, 0, (3.0, 1.0, 0.9), 16),
        Item("table", 8.4, 2.3, 0, (3.0, 1.0, 0.9), 17),
        Item("cabinet", 1.0, 4.3, 0, seed=17),
        Item("rack", 13.2, 4.2, 0, seed=9),
        Item("cabinet", 7.0, 4.3, 0, (2.0, 0.45, 1.1), 18),
    ),
    "0-strip-ne": (
        Item("bookcase", 2.0, 1.0, 0, seed=31),
        Item("bookcase", 4.0, 1.0, 0, seed=32),
        Item("bookcase", 2.0, 3.6, 0, seed=33),
        Item("bookcase", 4.0, 3.6, 0, seed=34),
        Item("cartons", 5.9, 2.6, -90, seed=13),
    ),
    "1-library": (
        *(
            Item("bookcase", 2.6 + 2.2 * (k % 2), 2.6 + 2.4 * (k // 2), 90 * 0, (2.0, 0.4, 2.0), 41 + k)
            for k in range(6)
        ),
        Item("counter", 8.2, 8.4, -60, seed=21),
        *_workplace(1.2, 10.8, 90, 21),
        Item("sofa", 8.4, 1.0, 180, seed=7),
        Item("plant", 0.5, 0.5, seed=9),
    ),
    "1-lecture": (
        *_seats(2.4, 7.6, 5, 8, 2),
        Item("counter", 3.2, 11.2, 0, (1.4, 0.6, 1.1), 23),
        Item("easel", 6.8, 11.4, 10, seed=9),
    ),
    "1-gallery-d": (
        Item("panel", 4.2, 4.0, 25, seed=11),
        Item("panel", 7.6, 5.4, -40, seed=12),
        Item("pedestal", 2.0, 6.6, 8, seed=12),
        Item("pedestal", 9.2, 2.2, 33, seed=13),
        Item("bench", 5.6, 7.2, 0, seed=7),
    ),
    "1-hall": (
        Item("column", 2.8, 2.4, 45, seed=0),
        Item("column", 7.9, 6.2, 45, seed=0),
        Item("table", 5.4, 4.6, 0, (2.6, 1.0, 0.74), 31),
        Item("bookcase", 10.5, 7.4, -90, seed=51),
        Item("sofa", 0.6, 6.4, 90, seed=8),
        Item("plant", 10.2, 0.6, seed=10),
    ),
    "1-members": (
        Item("sofa", 1.6, 1.2, 180, seed=11),
        Item("sofa", 5.4, 4.2, -90, seed=12),
        Item("table", 3.4, 3.6, 10, (1.1, 0.7, 0.45), 33),
        Item("cabinet", 6.8, 6.8, -90, seed=21),
        Item("bookcase", 3.6, 0.3, 180, (1.2, 0.35, 1.9), 53),
    ),
    "1-restrooms": (
        Item("cabinet", 0.45, 4.0, 90, (1.8, 0.5, 0.85), 23),
        Item("panel", 2.3, 2.0, 90, (2.6, 0.08, 2.0), 25),
    ),
    "1-lobby": (
        Item("bench", 0.5, 13.6, 90, seed=9),
        Item("plant", 3.4, 8.6, seed=12),
        Item("cabinet", 0.4, 3.2, 90, seed=25),
    ),
    "1-strip-sw": tuple(Item("bed", 1.6 + 2.3 * k, 1.1, 180, seed=k + 1) for k in range(5)),
    "1-strip-se": (
        *(Item("bed", 1.6 + 2.3 * k, 1.1, 180, seed=k + 11) for k in range(3)),
        Item("cabinet", 1.2, 4.5, 0, seed=27),
    ),
    "1-room-1": (
        Item("bed", 1.0, 4.4, 90, seed=21),
        *_workplace(5.4, 4.6, 0, 23),
        Item("cabinet", 6.4, 1.4, -90, seed=29),
    ),
    "1-room-2": (Item("bed", 5.4, 4.4, 0, seed=22), *_workplace(2.0, 4.6, 0, 25)),
    "1-room-3": (
        Item("bed", 1.2, 1.4, 0, seed=23),
        *_workplace(4.8, 1.4, 180, 27),
        Item("plant", 6.2, 5.0, seed=14),
    ),
    "1-room-4": (Item("bed", 5.4, 4.2, 0, seed=24), Item("cabinet", 1.4, 0.4, 180, seed=31)),
    "1-strip-nw": (
        *(Item("bed", 2.0 + 2.4 * k, 3.4, 0, seed=k + 31) for k in range(4)),
        Item("cabinet", 13.0, 4.3, 0, seed=33),
    ),
    "1-strip-ne": (
        Item("rack", 2.0, 1.0, 0, seed=21),
        Item("rack", 4.4, 3.6, 0, seed=22),
        Item("cartons", 5.8, 1.6, -90, seed=23),
    ),
}
