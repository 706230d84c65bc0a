import json

import cv2
import numpy as np
import pytest

from app.errors import InvalidInputError
from app.importers import tum
from app.importers.frames import ScanOptions
from bench.demo import render_queries, render_wing
from bench.recordings.cache import MARKER
from bench.render import frames
from bench.render.scene import Building, Scene


@pytest.fixture(autouse=True)
def small_scene(gallery: Scene, monkeypatch):
    monkeypatch.setattr(frames, "scene_of", lambda _: gallery)


def forbid_rendering(monkeypatch):
    def fail(_: Building) -> Scene:
        raise AssertionError("rendered again")

    monkeypatch.setattr(frames, "scene_of", fail)


def test_a_scan_is_written_once_in_tum_layout(tmp_path, monkeypatch):
    steps = []
    scan = render_wing(tmp_path / "wing", frames=3, workers=1, progress=lambda *step: steps.append(step))
    assert steps == [(1, 3), (2, 3), (3, 3)]
    names = {path.name for path in scan.directory.iterdir()}
    assert names == {"rgb", "depth", "rgb.txt", "depth.txt", "groundtruth.txt", "camera.txt", MARKER}
    depth = cv2.imread(str(scan.depth_path(1)), cv2.IMREAD_UNCHANGED)
    assert depth.dtype == np.uint16
    assert depth.shape == (480, 640)
    assert cv2.imread(str(scan.colour_path(2))).shape == (480, 640, 3)
    forbid_rendering(monkeypatch)
    assert len(render_wing(tmp_path / "wing", frames=3, workers=1)) == 3


def test_the_importer_reads_the_true_poses(tmp_path):
    written = render_wing(tmp_path / "wing", frames=3, workers=1)
    scan = tum.open_scan(written.directory, ScanOptions())
    found = list(scan.frames)
    assert len(found) == 3
    for frame, true in zip(found, written.world_from_camera, strict=True):
        assert np.allclose(frame.scan_from_camera.matrix, true.matrix, atol=1e-8)


def test_workers_write_the_same_bytes(tmp_path):
    alone = render_wing(tmp_path / "alone", frames=2, workers=1)
    together = render_wing(tmp_path / "together", frames=2, workers=2)
    for k in range(2):
        assert alone.colour_path(k).read_bytes() == together.colour_path(k).read_bytes()
        assert alone.depth_path(k).read_bytes() == together.depth_path(k).read_bytes()


def test_an_interrupted_render_goes_on_where_it_stopped(tmp_path, monkeypatch):
    target, made, make = tmp_path / "wing", [], frames.make_frame

    def stop_after_two(scene, job):
        if len(made) == 2:
            raise KeyboardInterrupt
        made.append(job.colour_path.name)
        make(scene, job)

    monkeypatch.setattr(frames, "make_frame", stop_after_two)
    with pytest.raises(KeyboardInterrupt):
        render_wing(target, frames=3, workers=1)
    assert not target.exists()
    monkeypatch.setattr(
        frames, "make_frame", lambda scene, job: (made.append(job.colour_path.name), make(scene, job))
    )
    render_wing(target, frames=3, workers=1)
    assert len(made) == len(set(made)) == 3


def test_another_recipe_replaces_a_render_but_foreign_files_stay(tmp_path):
    render_wing(tmp_path / "wing", frames=1, workers=1)
    assert len(list((render_wing(tmp_path / "wing", frames=2, workers=1).directory / "rgb").iterdir())) == 2
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "photo.jpg").write_bytes(b"precious")
    with pytest.raises(InvalidInputError, match="not empty"):
        render_wing(mine, frames=2, workers=1)
    assert (mine / "photo.jpg").read_bytes() == b"precious"


def test_queries_come_with_their_true_poses(tmp_path, monkeypatch):
    queries = render_queries(tmp_path / "queries", 2)
    listed = json.loads((tmp_path / "queries" / "queries.json").read_text())["queries"]
    for query, entry in zip(queries, listed, strict=True):
        assert query.path.is_file()
        assert entry["image"] == query.path.name
        assert list(entry["pose"]["position"].values()) == pytest.approx(
            query.world_from_camera.translation.tolist()
        )
        assert entry["camera"]["params"] == list(query.camera.params)
    forbid_rendering(monkeypatch)
    again = render_queries(tmp_path / "queries", 2)
    assert [q.name for q in again] == [q.name for q in queries]
    with pytest.raises(InvalidInputError, match="Region"):
        render_queries(tmp_path / "queries", 2, region="moon")
