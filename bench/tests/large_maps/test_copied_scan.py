"""A scan that is copied: each copy is elsewhere and is described in its own way."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from app.engine.mapping.build_map import build_map
from app.engine.mapping.keyframe_rule import parse_keyframe_rule
from app.engine.mapping.options import parse_build_options
from app.engine.progress import NoProgress
from app.importers.registry import open_scan
from bench.large_maps.builds_command import ALL_FRAMES
from bench.large_maps.copied_scan import CopiedModels, CopiedScan, CopyOfThread
from bench.large_maps.tiling import SPACING_M, order_of_copy
from tests.scenes import CAMERA_TEXT, View, scan_files

FRAMES = 4


def test_copies_of_a_scan_are_elsewhere_and_do_not_look_alike(tmp_path: Path, views: list[View]) -> None:
    for name, data in scan_files(views[:FRAMES]).items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    options = parse_build_options({"camera": CAMERA_TEXT, "refine_depth": False})
    options = replace(options, keyframes=parse_keyframe_rule(ALL_FRAMES), second_features=False)
    copy = CopyOfThread()
    source = CopiedScan(open_scan(tmp_path, "tum", options.scan), 2, copy)
    with ThreadPoolExecutor(2) as executor:
        built = build_map(source, options, CopiedModels(copy), executor, NoProgress())
    arrays = built.artifact.arrays
    assert [frame.name.split("/")[0] for frame in built.keyframes] == ["0"] * FRAMES + ["1"] * FRAMES
    middle = arrays.offsets[FRAMES]
    one, other = arrays.descriptors[:middle], arrays.descriptors[middle:]
    assert np.array_equal(other, one[:, order_of_copy(1, one.shape[1])])
    moved = arrays.points_in_world[middle:] - arrays.points_in_world[:middle]
    assert np.allclose(np.linalg.norm(moved, axis=1), SPACING_M, atol=1e-3)
    # What is elsewhere looks like nothing here: the nearest descriptors of other places are of the same copy.
    alike = built.index.descriptors[:FRAMES] @ built.index.descriptors[FRAMES:].T
    assert np.abs(alike).max() < 0.5
