"""Small scans written by code, and where the real ones lie."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from app.importers.frames import Scan

WIDTH, HEIGHT = 64, 48
INTRINSICS = (60.0, 60.0, 31.5, 23.5)
CAMERA_LINE = f"PINHOLE {WIDTH} {HEIGHT} 60 60 31.5 23.5"
IDENTITY = "0 0 0 1"


def real_scan(name: str) -> Path:
    """Return the folder of a real scan beside the repository, or skip the test."""
    folder = Path(__file__).resolve().parents[2].parent / "shared" / "data" / name
    if not folder.is_dir():
        pytest.skip(f"the real scan {name} is not beside the repository")
    return folder


def assert_has_no_depth(scan: Scan, frames: int) -> None:
    """Check a scan whose frames have no depth, and which says so once."""
    assert len(scan.frames) == frames
    assert not scan.has_depth
    assert scan.depth.camera is None
    assert sum("triangulated" in note for note in scan.notes) == 1
    for frame in scan.frames:
        depth_m = scan.depth_m(frame)
        assert depth_m.shape == (scan.camera.height, scan.camera.width)
        assert not depth_m.any()


def write_color(path: Path, width: int = WIDTH, height: int = HEIGHT) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    gradient = np.add.outer(np.arange(height), np.arange(width)) % 256
    assert cv2.imwrite(str(path), np.repeat(gradient[..., None], 3, axis=2).astype(np.uint8))


def write_depth(
    path: Path, raw: NDArray[np.uint16] | int = 5000, width: int = WIDTH, height: int = HEIGHT
) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    image = np.full((height, width), raw, np.uint16) if isinstance(raw, int) else raw
    assert cv2.imwrite(str(path), image)


def write_tum(folder: Path, times: list[float] | None = None, camera: str | None = CAMERA_LINE) -> Path:
    """Write a TUM scan: frame i at `times[i]`, i metres along x, and 1 m from a wall."""
    times = [0.0, 0.1, 0.2] if times is None else times
    folder.mkdir(parents=True, exist_ok=True)
    for time in times:
        write_color(folder / f"rgb/{time:.6f}.png")
        write_depth(folder / f"depth/{time:.6f}.png")
    for kind in ("rgb", "depth"):
        lines = [f"{time:.6f} {kind}/{time:.6f}.png" for time in times]
        (folder / f"{kind}.txt").write_text("\n".join(["# timestamp filename", *lines, ""]))
    poses = [f"{time:.6f} {i} 0 0 {IDENTITY}" for i, time in enumerate(times)]
    (folder / "groundtruth.txt").write_text("\n".join(["# timestamp tx ty tz qx qy qz qw", *poses, ""]))
    if camera is not None:
        (folder / "camera.txt").write_text(camera + "\n")
    return folder


def write_seven_scenes(folder: Path, numbers: list[int] | None = None) -> Path:
    """Write a 7-Scenes sequence: frame n is n centimetres along x, its rotation rounded to three decimals."""
    for number in [0, 1, 2] if numbers is None else numbers:
        stem = folder / f"frame-{number:06d}"
        write_color(stem.with_suffix(".color.png"))
        write_depth(stem.with_suffix(".depth.png"), 1000)
        matrix = np.eye(4)
        matrix[:2, :2] = [[0.866, -0.5], [0.5, 0.866]]
        matrix[0, 3] = number / 100
        np.savetxt(stem.with_suffix(".pose.txt"), matrix, fmt="%.7e", delimiter="\t")
    return folder


def write_video(path: Path, frames: int = 12, step_px: int = 8) -> Path:
    """A video of a printed band that moves to the left."""
    rng = np.random.default_rng(0)
    band = np.kron(rng.integers(0, 255, (20, 100, 3)), np.ones((8, 8, 1))).astype(np.uint8)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 10.0, (320, 160))
    for number in range(frames):
        writer.write(band[:, number * step_px : number * step_px + 320])
    writer.release()
    return path
