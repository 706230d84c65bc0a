"""Maps of rendered views, made without a build: for tests that choose what a map holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from app.engine.maps.artifact import MapArtifact, MapMetadata
from app.engine.maps.repetition import elsewhere
from app.engine.maps.vision_models import VisionModels
from app.engine.query.localizer import Localizer
from app.vision.images import to_gray
from app.vision.index import GlobalIndex
from tests.maps import map_of
from tests.scenes import CAMERA, View


@cache
def models() -> VisionModels:
    """Return the models, opened once for all tests."""
    return VisionModels()


def map_of_views(views: Sequence[View], features: str = "sift") -> tuple[MapArtifact, GlobalIndex]:
    """Return a map with every view as a keyframe: its features where the view has a depth above 0."""
    extractor, descriptor = models().extractor(features), models().global_descriptor
    points, descriptors = [], []
    for view in views:
        found = extractor.extract(to_gray(view.rgb))
        pixels = found.keypoints_px.astype(np.float64)
        u, v = np.rint(pixels).astype(int).T
        depth_m = view.depth_m[v, u]
        known = depth_m > 0
        points.append(view.world_from_camera.apply(CAMERA.unproject(pixels[known], depth_m[known])))
        descriptors.append(found.descriptors[known])
    poses = [view.world_from_camera for view in views]
    bare = map_of(poses, points, descriptors)
    arrays = bare.arrays
    distance, keyframe = elsewhere(
        arrays.descriptors, extractor.binary, arrays.points_in_world, arrays.offsets, poses
    )
    described = np.stack([descriptor.describe(view.rgb) for view in views])
    metadata = MapMetadata(
        features=features,
        descriptor_sha256=descriptor.sha256,
        descriptor_size=described.shape[1],
        cameras=(CAMERA,),
        keyframe_names=bare.metadata.keyframe_names,
    )
    arrays = replace(arrays, distance_elsewhere=distance, keyframe_elsewhere=keyframe)
    return MapArtifact(metadata=metadata, arrays=arrays), GlobalIndex.from_descriptors(described)


def localizer_of(views: Sequence[View], features: str = "sift") -> Localizer:
    """Return the localizer of the map of views."""
    return Localizer.of(*map_of_views(views, features), models())
