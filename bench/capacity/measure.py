"""Costs measured on this machine: bytes and build time by the maps of a data directory, commits in a database."""

from __future__ import annotations

import time
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from tempfile import TemporaryDirectory

from sqlalchemy import select

from app.storage.db import Database
from app.storage.sessions import SessionPoint, create_session, get_session, record_frame
from app.storage.tables import map_versions
from app.storage.venues import create_venue

FRAMES = 300
# Bytes of a tracker's memory, as a session of RedKitchen stores it.
MEMORY_BYTES = 4_000


@dataclass(frozen=True, slots=True)
class MapCosts:
    """Bytes of a keyframe and core seconds of a frame of the scan, over the maps of a data directory."""

    keyframe_bytes: float
    build_s: float


def map_costs(data_dir: Path) -> MapCosts | None:
    """Return the costs by the statistics of all maps of a data directory; None where there is none."""
    database = Database(f"sqlite:///{data_dir / 'roomfix.db'}")
    try:
        with database.read() as connection:
            found = [row.statistics for row in connection.execute(select(map_versions.c.statistics))]
    finally:
        database.close()
    keyframes = sum(entry["keyframes"] for entry in found)
    frames = sum(entry["frames"] for entry in found)
    if not keyframes or not frames:
        return None
    own = sum(sum(entry["bytes"].values()) for entry in found)
    seconds = sum(sum(entry["seconds"].values()) for entry in found)
    return MapCosts(own / keyframes, seconds / frames)


def commit_s(url: str | None = None) -> float:
    """Return the median seconds in which a database stores a frame of a session; SQLite in a folder without a URL."""
    with TemporaryDirectory() as folder:
        database = Database(url or f"sqlite:///{Path(folder) / 'capacity.db'}")
        try:
            database.migrate()
            return _commit_s(database)
        finally:
            database.close()


def _commit_s(database: Database) -> float:
    with database.write() as connection:
        create_venue(connection, "capacity", "Capacity")
        session = create_session(connection, "capacity", None, None, None)
    memory, times = {"state": "x" * MEMORY_BYTES}, []
    for frame in range(1, FRAMES + 1):
        point = SessionPoint(
            frame=frame,
            time_s=float(frame),
            tracking="tracking",
            pose=None,
            floor=None,
            plan=None,
            position_m=None,
        )
        started = time.perf_counter()
        with database.write() as connection:
            record_frame(connection, session, None, memory, point, FRAMES)
        times.append(time.perf_counter() - started)
        with database.read() as connection:
            session = get_session(connection, session.id, timedelta(hours=1))
    return sorted(times)[len(times) // 2]
