"""Maps without pictures: which features stay, what they weigh, and that no picture does."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest

from app.engine.mapping.options import parse_build_options
from app.engine.mapping.sparse_map import GRID, OPTIONS, feature_limit, thin_out
from app.engine.maps.points import MapPoints
from app.engine.query.localizer import Localizer
from app.geometry.camera import Camera
from app.jobs.handlers import handle_build
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.services.submit_build import submit_build
from app.settings import Settings
from app.storage.builds import claim_build, get_build
from app.storage.maps import get_map, list_keyframe_images
from app.storage.venues import create_venue
from app.vision.features import LocalFeatures
from app.vision.images import Rgb
from app.vision.local_features import FEATURE_NAMES, create_extractor
from tests.scenes import CAMERA, CAMERA_TEXT, View, scan_files, zipped


def some_points(count: int = 500) -> MapPoints:
    rng = np.random.default_rng(0)
    # Most of them crowd in one corner.
    spread = np.where(rng.random((count, 1)) < 0.8, [40.0, 30.0], [CAMERA.width, CAMERA.height])
    keypoints = (rng.random((count, 2)) * spread).astype(np.float32)
    features = LocalFeatures(keypoints, rng.integers(0, 256, (count, 128), dtype=np.uint8))
    return MapPoints(features, rng.random((count, 3)), rng.random(count), rng.integers(0, 6, count))


def cells(points: MapPoints) -> int:
    at = (points.features.keypoints_px + 0.5) / [CAMERA.width, CAMERA.height] * GRID
    return len(np.unique(at.astype(int), axis=0))


def test_all_features_stay_where_there_is_room() -> None:
    points = some_points()
    assert thin_out(points, CAMERA, None) is points
    assert thin_out(points, CAMERA, 500) is points


@pytest.mark.parametrize("limit", [60, 100, 300])
def test_features_that_stay_are_spread_over_the_image(limit: int) -> None:
    points = some_points()
    kept = thin_out(points, CAMERA, limit)
    assert len(kept.features) == len(kept.points_in_world) == len(kept.sigma_m) == limit
    # Every cell that held a feature still does.
    assert cells(kept) == cells(points)


def test_of_one_cell_those_stay_that_most_views_saw() -> None:
    points = some_points()
    corner = points.take(points.features.keypoints_px.max(axis=1) < 30)
    kept = thin_out(corner, CAMERA, 50)
    gone = ~np.isin(corner.sigma_m, kept.sigma_m)
    assert gone.sum() == len(corner.features) - 50 > 100
    # Four views and more count alike.
    assert np.minimum(corner.views[gone], 4).max() <= np.minimum(kept.views, 4).min()
    both = np.minimum(corner.views, 4) == np.minimum(kept.views, 4).min()
    if (both & gone).any() and (both & ~gone).any():
        assert corner.sigma_m[both & ~gone].max() <= corner.sigma_m[both & gone].min()


@pytest.mark.parametrize("name", [name for name in FEATURE_NAMES if name != "surf"])
def test_a_keyframe_without_its_picture_stays_below_100_kb(name: str) -> None:
    extractor, size = create_extractor(name), 4096
    limit = feature_limit(parse_build_options({"store_images": False}), extractor, size)
    assert limit is not None
    width = 2 if extractor.descriptor_dtype is np.float32 else 1
    # Pixel, point and sigma as float32, and the global descriptor.
    assert (
        limit * (24 + width * extractor.descriptor_size) + 4 * size <= OPTIONS.max_keyframe_bytes == 100_000
    )
    assert limit > 400
    assert feature_limit(parse_build_options({}), extractor, size) is None
    given = parse_build_options({"max_features_per_keyframe": 77})
    assert feature_limit(given, extractor, size) == 77


def build(resources: Resources, views: list[View], **options: object) -> int:
    """Build a map as the worker does, archive and all, and return its version."""
    archive = io.BytesIO(zipped(scan_files(views)))
    submit_build(resources, "v", {"camera": CAMERA_TEXT, **options}, archive)
    with resources.database.write() as connection:
        claimed = claim_build(connection)
    assert claimed is not None
    handle_build(claimed, resources, MapLibrary(resources))
    with resources.database.read() as connection:
        ended = get_build(connection, claimed.id)
    assert ended.state == "succeeded", ended.error
    assert ended.map_version is not None
    return ended.map_version


def test_no_picture_of_a_scan_stays_and_the_map_locates_and_grows(
    tmp_path: Path, views: list[View], queries: list[View]
) -> None:
    resources = Resources.open(Settings(_env_file=None, data_dir=tmp_path, open=True))
    with resources.database.write() as connection:
        create_venue(connection, "v", "V")
    for options in ({}, {"mode": "extend"}):
        version = build(resources, views[:7], store_images=False, **options)
        with resources.database.read() as connection:
            stored = get_map(connection, "v", version)
            assert list_keyframe_images(connection, "v", version) == []
        blobs = {stored.artifact_blob, stored.index_blob}
        assert blobs <= resources.blobs.digests()
        for digest in resources.blobs.digests():
            data = resources.blobs.local_path(digest).read_bytes()
            assert not any(data.startswith(magic) for magic in (b"\x89PNG", b"\xff\xd8\xff", b"PK"))
            assert b"\x89PNG" not in data
        located = locate(resources, [query.rgb for query in queries[:2]], CAMERA)
        for found, query in zip(located, queries[:2], strict=True):
            assert np.linalg.norm(found - query.world_from_camera.translation) < 0.02


def locate(resources: Resources, pictures: list[Rgb], camera: Camera) -> list[np.ndarray]:
    serving = MapLibrary(resources).active("v")
    assert serving is not None
    found = [Localizer(serving[0]).localize(rgb, camera).world_from_camera for rgb in pictures]
    assert all(pose is not None for pose in found)
    return [pose.translation for pose in found if pose is not None]


def test_a_map_with_pictures_loses_them_all_when_a_scan_without_is_added(
    tmp_path: Path, views: list[View]
) -> None:
    resources = Resources.open(Settings(_env_file=None, data_dir=tmp_path, open=True))
    with resources.database.write() as connection:
        create_venue(connection, "v", "V")
    first = build(resources, views[:6])
    second = build(resources, views[:6], store_images=False, mode="extend")
    with resources.database.read() as connection:
        assert list_keyframe_images(connection, "v", first)
        assert list_keyframe_images(connection, "v", second) == []
