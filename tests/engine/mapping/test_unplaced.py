"""A map without depth knows of its features without points when it says what looks alike."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.engine.mapping import build_map as builds
from app.engine.mapping.options import BuildOptions
from app.engine.progress import NoProgress
from app.geometry.camera_hint import hint_of
from app.importers.frames import ScanOptions
from app.importers.registry import open_scan
from tests.rendered_maps import models
from tests.scenes import CAMERA, Room, pose_at, scan_files


@pytest.mark.parametrize("has_depth", [True, False])
def test_features_without_points_are_searched_in_maps_without_depth(
    room: Room, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_depth: bool
) -> None:
    views = [room.view(pose_at(1.2 + 0.1 * (i % 5), 0.7 + 0.12 * i, 1.4 + 0.05 * (i % 3))) for i in range(10)]
    for path, data in scan_files(views).items():
        if path.startswith("depth") and not has_depth:
            continue
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_bytes(data)
    scan = open_scan(tmp_path, "tum", ScanOptions(camera=hint_of(CAMERA)))
    asked: list[Any] = []
    own = builds.elsewhere

    def watched(*values: Any) -> Any:
        asked.append(values)
        return own(*values)

    monkeypatch.setattr(builds, "elsewhere", watched)
    with ThreadPoolExecutor(1) as executor:
        builds.build_map(scan, BuildOptions(), models(), executor, NoProgress())
    ((descriptors, *_, unplaced),) = asked
    assert (unplaced is None) == has_depth
    if not has_depth:
        # Each feature of a keyframe is either among those with points or among those without.
        both = np.concatenate([descriptors, unplaced.descriptors])
        assert 0 < len(unplaced.descriptors) < len(both)
        assert len(np.unique(both, axis=0)) == len(both)
        assert np.all(unplaced.rays_in_camera[:, 2] > 0)
