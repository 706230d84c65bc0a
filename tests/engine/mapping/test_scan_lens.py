"""A scan through a lens that nobody stated: its views show it, and queries by the same camera are taken through it."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from app.engine.mapping.refine_scan import RefinedScan, refined_scan
from app.engine.mapping.scan_lens import learn_lens
from app.engine.maps.artifact import MapArtifact, MapMetadata
from app.engine.maps.points import View, points_from_depth
from app.engine.progress import NoProgress
from app.engine.query.camera import lens_of_query, scanned_camera
from app.geometry.camera import Camera
from app.geometry.depth import sample_depth
from app.geometry.focal import ApproximateCamera
from app.geometry.lens import Lens
from app.vision.images import to_gray
from app.vision.local_features import RootSift
from tests.maps import map_of
from tests.scenes import CAMERA, Room, pose_at, walk

COEFFICIENT = -0.12
EXTRACTOR = RootSift(max_features=300)


def views_through(camera: Camera) -> dict[int, View]:
    """Return the views of a walk, by row."""
    room, out = Room(3), {}
    for row, pose in enumerate(walk(12)):
        view = room.view(pose, camera)
        features = EXTRACTOR.extract(to_gray(view.rgb))
        depth_m = sample_depth(view.depth_m.astype(np.float32), features.keypoints_px)
        out[row] = View(pose, features, depth_m)
    return out


@pytest.fixture(scope="module")
def bent() -> dict[int, View]:
    """Views through a lens."""
    return views_through(Lens(COEFFICIENT).of(CAMERA))


def learned(views: dict[int, View], camera: Camera = CAMERA) -> Lens | None:
    with ThreadPoolExecutor(1) as executor:
        return learn_lens(views, sorted(views), camera, EXTRACTOR, executor, NoProgress())


def refined(views: dict[int, View]) -> RefinedScan:
    with ThreadPoolExecutor(1) as executor:
        rows = sorted(views)
        return refined_scan(views, rows[::3], rows, CAMERA, EXTRACTOR, executor, NoProgress())


def test_the_views_of_a_scan_show_its_lens(bent: dict[int, View]) -> None:
    found = learned(bent)
    assert found is not None
    assert found.coefficient == pytest.approx(COEFFICIENT, abs=3 * found.sigma)
    assert found.sigma < 0.01


def test_a_map_is_made_through_the_lens(bent: dict[int, View]) -> None:
    made = refined(bent)
    assert made.camera.params[4] == pytest.approx(COEFFICIENT, abs=0.015)
    assert made.lens_sigma > 0
    lens, rows = Lens(COEFFICIENT).of(CAMERA), sorted(bent)[::3]
    for row, found in zip(rows, made.points, strict=True):
        true = cKDTree(points_from_depth(bent[row], lens).points_in_world)
        as_stated = points_from_depth(bent[row], CAMERA).points_in_world
        # Refined points come in the order of the features, before those that other frames lend.
        own = found.points_in_world[: len(as_stated) // 2]
        assert np.median(true.query(own)[0]) < 0.5 * np.median(true.query(as_stated)[0])


def test_no_lens_is_made_up() -> None:
    views = views_through(CAMERA)
    found = learned(views)
    assert found is not None
    assert found.coefficient == 0.0
    made = refined(views)
    assert (made.camera, made.lens_sigma) == (CAMERA, found.sigma)
    shown = MapMetadata(
        features="sift",
        descriptor_sha256="",
        descriptor_size=8,
        cameras=(made.camera,),
        keyframe_names=("0.png",),
        lens_sigmas=(made.lens_sigma,),
    )
    # A query by the same camera needs no lens fitted, nor a session to learn it.
    assert lens_of_query(shown, CAMERA) == found
    assert not found.is_guess
    stated = scanned_camera(shown, CAMERA)
    assert (stated.model, stated.is_distorted) == ("OPENCV", False)
    assert np.array_equal(stated.project([[0.3, 0.2, 1.0]]), CAMERA.project([[0.3, 0.2, 1.0]]))


def test_a_stated_lens_is_believed(bent: dict[int, View]) -> None:
    assert learned(bent, Lens(-0.01).of(CAMERA)) is None


def test_too_few_views_show_no_lens(bent: dict[int, View]) -> None:
    assert learned({0: bent[0], 1: bent[1]}) is None


@pytest.fixture
def metadata() -> MapMetadata:
    """A map whose scan showed its lens."""
    return MapMetadata(
        features="sift",
        descriptor_sha256="",
        descriptor_size=8,
        cameras=(Lens(-0.03).of(CAMERA),),
        keyframe_names=("0.png",),
        lens_sigmas=(0.003,),
    )


def test_a_query_by_the_camera_of_the_scan_has_its_lens(metadata: MapMetadata) -> None:
    fx, fy, cx, cy = CAMERA.params
    turned = Camera("PINHOLE", CAMERA.height, CAMERA.width, (fy, fx, cy, cx))
    cropped = Camera("PINHOLE", 224, 168, (fx, fy, cx - 48, cy - 36))
    for camera in (CAMERA, turned, cropped, CAMERA.scaled_to(640, 480)):
        assert lens_of_query(metadata, camera) == Lens(-0.03, 0.003)
        assert scanned_camera(metadata, camera) == Lens(-0.03).of(camera)


def test_another_camera_is_taken_for_a_pinhole_at_first(metadata: MapMetadata) -> None:
    other = Camera("PINHOLE", 320, 240, (270.0, 270.0, 159.5, 119.5))
    assert lens_of_query(metadata, other) == Lens()
    assert lens_of_query(metadata, None) == Lens()
    assert lens_of_query(metadata, ApproximateCamera(CAMERA)) == Lens()
    assert scanned_camera(metadata, other) == other


def test_a_query_that_states_its_distortion_is_believed(metadata: MapMetadata) -> None:
    stated = Lens(-0.2).of(CAMERA)
    assert lens_of_query(metadata, stated) is None
    assert scanned_camera(metadata, stated) == stated


def test_what_was_learned_of_the_lens_is_stored(metadata: MapMetadata, tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(0, 2, (5, 3))
    made = map_of([pose_at(1.0, 1.0)], [points], [np.zeros((5, 8), np.uint8)])
    replace(made, metadata=metadata).write(tmp_path / "map.bin")
    assert MapArtifact.open(tmp_path / "map.bin").metadata == metadata
