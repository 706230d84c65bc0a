import json
from pathlib import Path

import numpy as np
import pytest

from app.geometry.se3 import Pose
from bench.recordings.scan import WING_FRAMES
from bench.recordings.trajectory import WING_WALK, scan_poses
from bench.recordings.video import VIDEO_FRAMES, VIDEO_WALK, render_video
from bench.render import frames
from bench.render.scene import Scene


def test_neighbours_are_a_fourth_as_far_apart_as_the_wings() -> None:
    def step_m(poses: list[Pose]) -> float:
        return float(np.max(np.linalg.norm(np.diff([pose.translation for pose in poses], axis=0), axis=1)))

    assert step_m(scan_poses(VIDEO_WALK, VIDEO_FRAMES)) < 0.3 * step_m(scan_poses(WING_WALK, WING_FRAMES))


def test_scan_and_pictures_are_rendered(
    tmp_path: Path, gallery: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(frames, "scene_of", lambda _: gallery)
    scan, queries = render_video(tmp_path, frames=2, queries=1, workers=1)
    assert len(scan) == 2
    assert scan.colour_path(1).is_file()
    listed = json.loads((tmp_path / "queries" / "queries.json").read_text())
    assert [listed["region"], len(listed["queries"])] == ["video", len(queries)]
