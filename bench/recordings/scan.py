"""The scans of the demonstration venue on disk, in TUM RGB-D layout."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from app.geometry.camera import REFERENCE_FOCAL_PX, Camera
from app.geometry.se3 import Pose
from bench.recordings.cache import make_directory
from bench.recordings.trajectory import VENUE_WALK, WING_WALK, Walk, scan_poses
from bench.render.frames import FrameJob, Progress, make_frames
from bench.render.raycast import FINE, Quality
from bench.render.scene import DEMONSTRATION, SCENE_VERSION, Building
from bench.render.sensor import DEPTH_SCALE, ColourSensor

SCAN_CAMERA = Camera("PINHOLE", 640, 480, (REFERENCE_FOCAL_PX, REFERENCE_FOCAL_PX, 319.5, 239.5))
WING_FRAMES = 300
VENUE_FRAMES = 2400
FRAME_INTERVAL_S = 0.4
# Real colour and depth cameras don't fire together; here the depth pictures only claim to be a little later.
DEPTH_DELAY_S = 0.004
START_S = 1000.0


@dataclass(frozen=True, slots=True)
class DemoScan:
    """A scan in TUM layout: its directory, camera, depth units per metre, and true pose of each frame."""

    directory: Path
    camera: Camera
    depth_scale: float
    timestamps_s: tuple[float, ...]
    world_from_camera: tuple[Pose, ...]

    def __len__(self) -> int:
        return len(self.timestamps_s)

    def colour_path(self, frame: int) -> Path:
        """The JPEG of a frame."""
        return self.directory / "rgb" / f"{self.timestamps_s[frame]:.6f}.jpg"

    def depth_path(self, frame: int) -> Path:
        """The 16-bit PNG of a frame."""
        return self.directory / "depth" / f"{self.timestamps_s[frame] + DEPTH_DELAY_S:.6f}.png"


def render_wing(
    directory: Path, *, frames: int = WING_FRAMES, workers: int = 2, progress: Progress | None = None
) -> DemoScan:
    """Render the scan of the main wing, or return at once when the directory holds it.

    `progress(done, total)` is called as frames are written. Raises `InvalidInputError` when the directory
    holds something else.
    """
    return render_scan("wing", WING_WALK, directory, frames, workers, progress)


def render_venue(
    directory: Path, *, frames: int = VENUE_FRAMES, workers: int = 2, progress: Progress | None = None
) -> DemoScan:
    """Render the scan of both floors with all look-alike corridors; otherwise as `render_wing`."""
    return render_scan("venue", VENUE_WALK, directory, frames, workers, progress)


def render_scan(
    name: str, walks: tuple[Walk, ...], directory: Path, frames: int, workers: int, progress: Progress | None
) -> DemoScan:
    """Render the scan of some walks, `name` seeding its noise; otherwise as `render_wing`."""
    return render_poses(name, tuple(scan_poses(walks, frames)), directory, workers, progress)


def render_poses(
    name: str,
    poses: tuple[Pose, ...],
    directory: Path,
    workers: int,
    progress: Progress | None,
    building: Building = DEMONSTRATION,
    quality: Quality = FINE,
) -> DemoScan:
    """Render the scan of some poses in a building; otherwise as `render_scan`."""
    frames = len(poses)
    times = tuple(START_S + FRAME_INTERVAL_S * k for k in range(frames))
    scan = DemoScan(directory, SCAN_CAMERA, DEPTH_SCALE, times, poses)

    def fill(partial: Path) -> None:
        part = DemoScan(partial, scan.camera, scan.depth_scale, times, poses)
        for folder in ("rgb", "depth"):
            (partial / folder).mkdir(exist_ok=True)
        jobs = frame_jobs(part, name, quality)
        make_frames(partial, jobs, workers, progress, building)
        write_lists(part)

    make_directory(directory, _recipe(name, frames, building), fill)
    return scan


def frame_jobs(scan: DemoScan, name: str, quality: Quality = FINE) -> list[FrameJob]:
    """Return what is rendered of a scan, colour and depth of each frame; the noise comes from its name."""
    return [
        FrameJob(
            camera=scan.camera,
            world_from_camera=pose,
            colour_path=scan.colour_path(k),
            depth_path=scan.depth_path(k),
            seed=(name, k),
            sensor=ColourSensor(),
            quality=quality,
        )
        for k, pose in enumerate(scan.world_from_camera)
    ]


def _recipe(name: str, frames: int, building: Building) -> dict[str, Any]:
    return {"scan": name, "frames": frames, "version": SCENE_VERSION, **building.recipe}


def write_lists(scan: DemoScan) -> None:
    """Write `rgb.txt`, `depth.txt`, `groundtruth.txt` and `camera.txt`."""
    times, root = scan.timestamps_s, scan.directory
    colour = [f"{t:.6f} rgb/{scan.colour_path(k).name}" for k, t in enumerate(times)]
    depth = [f"{t + DEPTH_DELAY_S:.6f} depth/{scan.depth_path(k).name}" for k, t in enumerate(times)]
    _write(root / "rgb.txt", ["# colour images", "# timestamp filename", *colour])
    _write(root / "depth.txt", ["# depth images", "# timestamp filename", *depth])
    truth = [f"{t:.6f} {pose_text(pose)}" for t, pose in zip(times, scan.world_from_camera, strict=True)]
    _write(root / "groundtruth.txt", ["# world_from_camera", "# timestamp tx ty tz qx qy qz qw", *truth])
    camera = scan.camera
    _write(
        root / "camera.txt",
        [
            "# model width height fx fy cx cy; "
            f"depth_scale = {scan.depth_scale:.0f} per metre, registered to colour",
            f"{camera.model} {camera.width} {camera.height} " + " ".join(f"{p:g}" for p in camera.params),
        ],
    )


def pose_text(pose: Pose) -> str:
    """Return `tx ty tz qx qy qz qw` with nine digits after the point."""
    return " ".join(f"{value:.9f}" for value in (*pose.translation, *pose.quaternion))


def _write(path: Path, lines: Sequence[str]) -> None:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
