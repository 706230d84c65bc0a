"""A tiny scan that no axis, order or size can be exchanged in without notice."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from app.geometry.camera import Camera
from app.geometry.se3 import Pose, rotation_from_vector
from bench.formats.frames import WrittenFrame, WrittenScan

# Of the shape of a phone's depth images, as the writers for phones make those from it.
WIDTH = 320
HEIGHT = 240
CAMERA = Camera("PINHOLE", WIDTH, HEIGHT, (280.0, 284.0, 161.0, 118.0))
FRAMES = 5
# What people have around a scan when they pack it.
OUTER_FOLDERS = ("", "my scan/", "2026/my scan/")


def tiny_scan() -> WrittenScan:
    """Return five frames of a slope with a texture, with arbitrary poses and y down in their world."""
    rng = np.random.default_rng(5)
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    depth_m = (1.0 + 0.002 * u + 0.003 * v).astype(np.float32)
    frames = []
    for i in range(FRAMES):
        bgr = np.stack([(u + 10 * i) % 256, (v + 3 * i) % 256, (u + v) % 256], axis=-1).astype(np.uint8)
        pose = Pose(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3))
        frames.append(WrittenFrame(100.0 + 0.1 * i, bgr, depth_m, pose))
    return WrittenScan(CAMERA, tuple(frames), (0.0, 1.0, 0.0))


def packed(written: Path, archive: Path, outer: str) -> Path:
    """Write a zip of a written folder or file with its paths below `outer`, and return it."""
    files = [path for path in sorted(written.rglob("*")) if path.is_file()] or [written]
    top = written if written.is_dir() else written.parent
    with zipfile.ZipFile(archive, "w") as packing:
        for path in files:
            packing.write(path, outer + path.relative_to(top).as_posix())
    return archive
