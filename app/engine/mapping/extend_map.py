"""Extension: a map joined with another map of the same venue and world."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.artifact import MapArrays, MapArtifact, MapMetadata
from app.engine.maps.repetition import elsewhere
from app.engine.maps.second_features import SecondFeatures
from app.errors import InvalidInputError
from app.vision.index import GlobalIndex
from app.vision.repetition import RunChunks


def join_maps(
    old: MapArtifact,
    old_index: GlobalIndex,
    new: MapArtifact,
    new_index: GlobalIndex,
    binary: bool,
    run: RunChunks = map,
) -> tuple[MapArtifact, GlobalIndex]:
    """Return the map with the keyframes of both, the old ones first; `binary`: whether their descriptors are binary,
    `run` as in `find_repetition`.

    Raises `InvalidInputError` when they were made with other features or another global descriptor.
    """
    if old.metadata.features != new.metadata.features:
        raise InvalidInputError(
            f"The present map has {old.metadata.features} features, the new scan {new.metadata.features}; a map "
            "is extended with the features it has."
        )
    if old.metadata.descriptor_sha256 != new.metadata.descriptor_sha256:
        raise InvalidInputError("The present map was made with another global descriptor model.")
    a, b = old.arrays, new.arrays
    points_in_world = np.concatenate([a.points_in_world, b.points_in_world])
    descriptors = np.concatenate([a.descriptors, b.descriptors])
    offsets = np.concatenate([a.offsets, a.offsets[-1] + b.offsets[1:]])
    # A feature that is distinct in one map may have a similar one in the other.
    poses = [part.pose(row) for part in (old, new) for row in range(part.keyframe_count)]
    z_up = old.metadata.z_up or new.metadata.z_up
    distance, keyframe = elsewhere(descriptors, binary, points_in_world, offsets, poses, z_up, run)
    distance, keyframe = _with_known(distance, keyframe, old, new)
    arrays = MapArrays(
        positions=np.concatenate([a.positions, b.positions]),
        quaternions=np.concatenate([a.quaternions, b.quaternions]),
        camera_rows=np.concatenate([a.camera_rows, b.camera_rows + np.int32(len(old.metadata.cameras))]),
        offsets=offsets,
        keypoints_px=np.concatenate([a.keypoints_px, b.keypoints_px]),
        points_in_world=points_in_world,
        point_sigma_m=np.concatenate([a.point_sigma_m, b.point_sigma_m]),
        distance_elsewhere=distance,
        keyframe_elsewhere=keyframe,
        descriptors=descriptors,
    )
    metadata = MapMetadata(
        features=old.metadata.features,
        descriptor_sha256=old.metadata.descriptor_sha256,
        descriptor_size=old.metadata.descriptor_size,
        cameras=old.metadata.cameras + new.metadata.cameras,
        keyframe_names=old.metadata.keyframe_names + new.metadata.keyframe_names,
        position_sigma_m=max(old.metadata.position_sigma_m, new.metadata.position_sigma_m),
        orientation_sigma_deg=max(old.metadata.orientation_sigma_deg, new.metadata.orientation_sigma_deg),
        lens_sigmas=old.metadata.lens_sigmas + new.metadata.lens_sigmas,
        z_up=z_up,
    )
    global_descriptors = np.concatenate([old_index.descriptors, new_index.descriptors])
    return MapArtifact(
        metadata=metadata, arrays=arrays, second=_second(old, new)
    ), GlobalIndex.from_descriptors(global_descriptors)


def _with_known(
    distance: NDArray[np.float16], keyframe: NDArray[np.int32], old: MapArtifact, new: MapArtifact
) -> tuple[NDArray[np.float16], NDArray[np.int32]]:
    """Return what both maps know of look-alikes where it is nearer than what was found: features without points, which
    are not stored, were known when each was built."""
    a, b = old.arrays, new.arrays
    known = np.concatenate([a.distance_elsewhere, b.distance_elsewhere])
    own = np.asarray(b.keyframe_elsewhere)
    shifted = np.where(own < 0, -1, own + old.keyframe_count)
    whose = np.concatenate([a.keyframe_elsewhere, shifted]).astype(np.int32)
    is_nearer = (whose >= 0) & (known < distance)
    return np.where(is_nearer, known, distance), np.where(is_nearer, whose, keyframe)


def _second(old: MapArtifact, new: MapArtifact) -> SecondFeatures | None:
    """Return the second features of both maps; a map without them has none in its part."""
    if old.second is None and new.second is None:
        return None
    return SecondFeatures.join(
        [part.second or SecondFeatures.none(part.keyframe_count) for part in (old, new)]
    )
