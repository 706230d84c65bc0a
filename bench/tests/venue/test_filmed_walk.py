"""The walk that is filmed at 60 frames a second: smooth, clear of things, and seen by its cameras."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from app.geometry.camera import Camera
from app.geometry.se3 import attitude_difference_rad, position_difference_m
from app.importers.frames import ScanOptions
from app.importers.registry import open_scan
from bench.recordings.filmed_walk import CAMERAS_M, FPS, SECONDS, SPEED_M_S, render_filmed_walk
from bench.render import frames
from bench.render.scene import build_scene
from bench.render.surfaces import Surface
from bench.venue.walkable import clearance_m

pytest.importorskip("embreex")


def test_a_filmed_walk_is_a_scan_of_cameras_and_smooth_steps(
    tmp_path: Path, surfaces: list[Surface], monkeypatch: pytest.MonkeyPatch
) -> None:
    hall = build_scene([each for each in surfaces if each.room == "0-hall"])
    monkeypatch.setattr(frames, "scene_of", lambda _: hall)
    camera = Camera("PINHOLE", 32, 18, (25.0, 25.0, 15.5, 8.5))
    walk = render_filmed_walk(tmp_path / "walk", camera)
    read = open_scan(walk.scan.directory, None, ScanOptions())
    assert len(read.frames) == len(walk.scan) == len(CAMERAS_M) + FPS * SECONDS
    poses = [frame.scan_from_camera for frame in read.frames[walk.cameras :]]
    steps_m = [position_difference_m(a, b) for a, b in pairwise(poses)]
    turns_deg = [np.degrees(attitude_difference_rad(a, b)) for a, b in pairwise(poses)]
    assert max(steps_m) < 1.5 * SPEED_M_S / FPS
    assert max(turns_deg) < 0.6
    assert sum(steps_m) == pytest.approx(SPEED_M_S * SECONDS, rel=0.05)
    # Nobody walks through furniture, and no camera hangs in any.
    places = np.array([pose.translation[:2] for pose in poses])
    assert clearance_m(places, 0).min() > 0.1
    assert clearance_m(np.array(CAMERAS_M), 0).min() > 0.1
    # All look at the wall in the north.
    assert min(frame.scan_from_camera.rotation[1, 2] for frame in read.frames) > 0.7
