"""The look-alike corridors and the lobbies of both floors of another building: their scan, and phone pictures."""

from __future__ import annotations

from pathlib import Path

from app.geometry.se3 import Pose
from bench.recordings.queries import PHONE_CAMERA, DemoQuery, floor_of, render_queries_near, room_of
from bench.recordings.scan import VENUE_FRAMES, DemoScan, render_poses
from bench.recordings.trajectory import VENUE_WALK, scan_poses
from bench.render.frames import Progress
from bench.render.raycast import FAST
from bench.render.scene import Building
from bench.venue.layout import CORRIDORS

# Rooms by the name that both floors share.
LOBBY = "lobby"


def twin_poses(number: int) -> list[Pose]:
    """Return the poses of a walk through a building's corridors and lobbies, on both floors."""
    return [pose for pose in scan_poses(VENUE_WALK, VENUE_FRAMES, number) if is_twin(pose)]


def is_twin(world_from_camera: Pose) -> bool:
    """Return whether a camera is in a corridor or a lobby."""
    room = room_of(world_from_camera)
    return room is not None and (room.id in CORRIDORS or room.id.endswith(LOBBY))


def render_twin_scan(directory: Path, number: int, workers: int, progress: Progress | None) -> DemoScan:
    """Render the scan of a building's corridors and lobbies, or return at once when the directory holds it."""
    poses = tuple(twin_poses(number))
    return render_poses(f"twins {number}", poses, directory, workers, progress, Building(number), FAST)


def render_twin_queries(
    directory: Path, number: int, floor: int, count: int, workers: int, progress: Progress | None
) -> list[DemoQuery]:
    """Render phone pictures of a floor's corridors and lobby, or return at once when the directory holds them."""
    scan = [pose for pose in twin_poses(number) if floor_of(pose) == floor]
    return render_queries_near(
        scan,
        directory,
        count,
        f"twins of floor {floor}",
        camera=PHONE_CAMERA,
        seed=number,
        workers=workers,
        progress=progress,
        building=Building(number),
    )
