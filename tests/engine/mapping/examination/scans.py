"""A scan of the synthetic room in a folder, and mistakes made on its files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.examination.examine import examine_scan
from app.engine.mapping.examination.outcome import Examination
from app.engine.mapping.options import parse_build_options
from app.engine.progress import NoProgress
from app.geometry.se3 import Pose
from app.importers.conventions import PoseArrays, PoseConvention
from app.importers.registry import open_scan
from tests.scenes import CAMERA, View, encode, scan_files

Files = dict[str, bytes]
DOWN = [0, 0, -1]
OPTIONS: Mapping[str, Any] = {"camera": list(CAMERA.params), "gravity": DOWN}


def write(files: Mapping[str, bytes], folder: Path) -> Path:
    """Write files below a folder."""
    for name, data in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    return folder


def with_poses(views: list[View], change: Callable[[list[Pose]], list[Pose]]) -> Files:
    """Return the scan's files with other poses."""
    poses = change([view.world_from_camera for view in views])
    return scan_files([View(pose, view.rgb, view.depth_m) for pose, view in zip(poses, views, strict=True)])


def written(convention: PoseConvention) -> Callable[[list[Pose]], list[Pose]]:
    """Return what a convention writes for poses."""
    return lambda poses: convention.written(PoseArrays.of(poses)).poses()


def with_images(
    files: Files,
    picture: Callable[[NDArray[np.uint8]], NDArray[np.uint8]],
    depth: Callable[[NDArray[np.uint16]], NDArray[np.uint16]],
) -> Files:
    """Return the files with changed pictures and depth images."""
    changed = dict(files)
    for name, data in files.items():
        if not name.endswith(".png"):
            continue
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        new = depth(image) if name.startswith("depth/") else picture(image)
        changed[name] = encode(np.ascontiguousarray(new), ".png")
    return changed


def examined(folder: Path, options: Mapping[str, Any] = OPTIONS) -> Examination:
    """Examine the scan of a folder as a build with these options would."""
    parsed = parse_build_options(dict(options))
    scan = open_scan(folder, parsed.format, parsed.scan)
    with ThreadPoolExecutor(2) as executor:
        return examine_scan(scan, parsed.scan, parsed.gravity or scan.gravity, executor, NoProgress())
