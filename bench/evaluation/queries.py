"""Pictures with known poses to locate: frames of a scan, or a folder with `queries.json`."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from app.engine.mapping.frame_images import frame_rgb
from app.errors import InvalidInputError
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.importers.frames import Frame, Scan
from app.vision.images import Rgb, decode_image
from bench.evaluation.dataset import parse_range


@dataclass(frozen=True, slots=True)
class Query:
    """A picture, its camera and its true pose in the frame of the scan."""

    name: str
    read: Callable[[], Rgb]
    camera: Camera
    scan_from_camera: Pose


def open_queries(text: str, scan: Scan, known: Sequence[Frame]) -> list[Query]:
    """Return the queries: `start:stop:step` of the scan's frames without the known ones, or a folder's.

    Raises `InvalidInputError` when there are none.
    """
    folder = Path(text)
    queries = _of_folder(folder) if folder.is_dir() else _of_scan(parse_range(text), scan, known)
    if not queries:
        raise InvalidInputError(f"{text!r} leaves no query.")
    return queries


def _of_scan(part: slice, scan: Scan, known: Sequence[Frame]) -> list[Query]:
    names = {frame.name for frame in known}
    return [
        Query(frame.name, partial(frame_rgb, scan, frame), scan.camera, frame.scan_from_camera)
        for frame in scan.frames[part]
        if frame.name not in names
    ]


def _of_folder(folder: Path) -> list[Query]:
    try:
        listed = json.loads((folder / "queries.json").read_text(encoding="utf-8"))["queries"]
        return [_query(folder, item) for item in listed]
    except (OSError, ValueError, KeyError, TypeError):
        raise InvalidInputError(
            f"{folder.name} holds no queries.json with name, image, camera and pose of each picture."
        ) from None


def _query(folder: Path, item: dict[str, Any]) -> Query:
    camera, pose = item["camera"], item["pose"]
    path = folder / item["image"]
    return Query(
        item["name"],
        lambda: decode_image(path.read_bytes()),
        Camera(camera["model"], camera["width"], camera["height"], tuple(camera["params"])),
        Pose.from_quaternion(
            [pose["position"][axis] for axis in "xyz"], [pose["quaternion"][axis] for axis in "xyzw"]
        ),
    )
