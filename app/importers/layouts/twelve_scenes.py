"""12-Scenes and 3RScan: frames named as in 7-Scenes beside an `info.txt` with both cameras.

Source of the layout: graphics.stanford.edu/projects/reloc and waldjohannau.github.io/RIO. 12-Scenes has the frames in
`data` below `info.txt`, 3RScan all files in `sequence`, with `_info.txt` among them.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidScanError
from app.geometry.camera_hint import CameraHint
from app.importers import seven_scenes
from app.importers.assembly import Discarded, ScanSource, assemble_scan
from app.importers.folder import ScanFolder
from app.importers.frames import Scan, ScanOptions
from app.importers.scan_files import numbers, optional_file, read_gravity, read_text

INFO = ("info.txt", "_info.txt")
FRAME_FOLDERS = ("data", "sequence")
DEFAULT_DEPTH_SCALE = 1000.0
COLOR_KEY = "m_calibrationColorIntrinsic"
DEPTH_KEY = "m_calibrationDepthIntrinsic"
EXTRINSIC_KEYS = ("m_calibrationColorExtrinsic", "m_calibrationDepthExtrinsic")


def detect(directory: Path) -> bool:
    """Return whether the folder holds the file of both cameras, and frames in it or below."""
    info = _info(directory)
    return info is not None and COLOR_KEY in read_text(info) and seven_scenes.detect(_frame_folder(directory))


def open_scan(directory: Path, options: ScanOptions) -> Scan:
    """Return the scan; both cameras are in one place, and poses are those of the colour camera.

    Raises `InvalidScanError` for files that are missing or not this, and for cameras that are stated to be apart.
    """
    path = _info(directory)
    if path is None:
        raise InvalidScanError("The scan's cameras are not known: info.txt is missing.")
    values = dict(_entries(read_text(path)))
    folder, discarded = ScanFolder(_frame_folder(directory)), Discarded()
    found = seven_scenes.frames_in(folder, options, discarded)
    scale = (
        numbers([values["m_depthShift"]], f"{path.name}: m_depthShift")[0]
        if "m_depthShift" in values
        else None
    )
    if found.has_depth and options.color_from_depth is None:
        _check_extrinsics(values, path.name)
    source = ScanSource(
        camera=options.camera or _intrinsics(values, COLOR_KEY, path.name),
        depth_camera=_intrinsics(values, DEPTH_KEY, path.name) if found.has_depth else None,
        depth_scale=scale,
        default_depth_scale=DEFAULT_DEPTH_SCALE,
        gravity=read_gravity(directory),
        notes=found.notes,
        has_depth=found.has_depth,
    )
    return assemble_scan(found.frames, discarded, source, options)


def _info(directory: Path) -> Path | None:
    return next(filter(None, (optional_file(directory, name) for name in INFO)), None)


def _frame_folder(directory: Path) -> Path:
    return ScanFolder(directory).subfolder(*FRAME_FOLDERS) or directory


def _entries(text: str) -> list[tuple[str, str]]:
    lines = (line.partition("=") for line in text.splitlines())
    return [(key.strip(), value.strip()) for key, sign, value in lines if sign]


def _check_extrinsics(values: dict[str, str], name: str) -> None:
    """Raise for colour and depth cameras that are stated to be apart, which both data sets never do."""
    places = [_matrix(values, key, name) for key in EXTRINSIC_KEYS if key in values]
    if any(not np.allclose(place, np.eye(4), atol=1e-4) for place in places):
        raise InvalidScanError(
            f"{name} says that colour and depth camera are apart: give depth_camera and color_from_depth."
        )


def _matrix(values: dict[str, str], key: str, name: str) -> NDArray[np.float64]:
    matrix = np.array(numbers(values.get(key, "").split(), f"{name}: {key}"))
    if len(matrix) != 16:
        raise InvalidScanError(f"{name}: {key} must be 16 numbers, a matrix of 4x4.")
    return matrix.reshape(4, 4)


def _intrinsics(values: dict[str, str], key: str, name: str) -> CameraHint:
    K = _matrix(values, key, name)
    return CameraHint(values=(float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])))
