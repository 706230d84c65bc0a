"""What one thing costs: a query, a frame of a session, a keyframe of a map, a commit."""

from __future__ import annotations

from dataclasses import dataclass

from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class Costs:
    """What one thing costs on one core of a server, and what one server of each kind can do."""

    query_s: float = limit(
        0.059, "Core seconds of `POST /locate`.", chosen="roomfix benchmark; docs/figures/benchmark.md."
    )
    session_frame_ratio: float = limit(
        0.37,
        "Core time of a session's frame over that of a query.",
        chosen="roomfix track; docs/figures/track.md.",
    )
    frame_bytes: int = limit(
        60_000,
        "Bytes of a frame.",
        chosen="By hand: a JPEG of 640 x 480 pixels at quality 85, as the pages send it.",
    )
    keyframe_bytes: int = limit(
        83_000,
        "Bytes of a keyframe in a map and its index.",
        chosen="roomfix capacity, from the statistics of a map of RedKitchen: 1,876,736 and 458,797 bytes for 28.",
    )
    picture_bytes: int = limit(
        250_000,
        "Bytes of a keyframe's colour and depth picture, where a build keeps them.",
        chosen="By hand: the size of RedKitchen's files.",
    )
    build_s: float = limit(
        0.030,
        "Core seconds of a build for each frame of the scan.",
        chosen="roomfix capacity, from the statistics of a map of RedKitchen: 9.1 s for 300 frames.",
    )
    commit_s: float = limit(
        0.0028,
        "Seconds in which the database stores one frame of a session, one after the other.",
        chosen="roomfix capacity, on SQLite; a PostgreSQL server has to be measured in its place.",
    )
    parallel_commits: int = limit(
        8,
        "Commits that a PostgreSQL server writes at once.",
        chosen="By hand: it flushes several commits together; measure yours.",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Demand:
    """What is asked of the service."""

    buildings: int
    keyframes_per_building: int
    versions_per_building: int
    frames_per_build: int
    builds_per_day: int
    phones: int
    fps: float
    queries_per_second: float
    busy_share: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """A server that is rented: its cores, memory, network, and how much of its cores may be in use."""

    cores: int
    memory_gb: float
    network_gbit_s: float
    use_share: float
    price_month: float
