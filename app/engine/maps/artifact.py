"""A map version's features: one packed file, memory-mapped and shared by all processes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.checked_rows import BlockChecker, CheckedRows
from app.engine.maps.packed_file import read_packed, write_packed
from app.engine.maps.second_features import SecondFeatures
from app.errors import MapDamagedError
from app.geometry.camera import Camera
from app.geometry.lens import Lens
from app.geometry.se3 import Pose

Floats = NDArray[np.float32] | CheckedRows[np.float32]
Halves = NDArray[np.float16] | CheckedRows[np.float16]
Numbers = NDArray[np.int32] | CheckedRows[np.int32]
Keys = NDArray[np.int64] | CheckedRows[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True)
class MapMetadata:
    """What a map was made with: feature method, model of the global descriptor, cameras.

    `position_sigma_m` and `orientation_sigma_deg` are the error that frames of its own scan have in it: what the
    map adds to the error of any pose. `lens_sigmas` are how well the lens of each camera is known where the scan
    didn't state it but showed it, 0 where it is as stated. `z_up` says whether the world's z axis is known to point up.
    Without `has_scale` all lengths are in a unit of the map's own instead of metres.
    """

    features: str
    descriptor_sha256: str
    descriptor_size: int
    cameras: tuple[Camera, ...]
    keyframe_names: tuple[str, ...]
    position_sigma_m: float = 0.0
    orientation_sigma_deg: float = 0.0
    lens_sigmas: tuple[float, ...] = ()
    z_up: bool = True
    has_scale: bool = True

    @property
    def shown_lenses(self) -> tuple[tuple[Camera, Lens], ...]:
        """The cameras whose lens the scan showed, or showed that there is none, with the lens."""
        pairs = zip(self.cameras, self.lens_sigmas, strict=False)
        return tuple((camera, Lens((*camera.params, 0.0)[4], sigma)) for camera, sigma in pairs if sigma > 0)


@dataclass(frozen=True, slots=True, kw_only=True)
class MapArrays:
    """A map's numbers for k keyframes with f features in all.

    `positions` (k, 3) and `quaternions` (k, 4; x y z w) are world_from_camera; `camera_rows` (k,) index the
    cameras; keyframe i owns the features `offsets[i]:offsets[i + 1]`, `offsets` (k + 1,). Per feature:
    `keypoints_px` (f, 2), `points_in_world` (f, 3) in metres, `point_sigma_m` (f,) along the ray,
    `distance_elsewhere` (f,), how far off in unit descriptors the most similar feature at another place is,
    `keyframe_elsewhere` (f,), which keyframe has it (-1: none is known), and `descriptors` (f, d).
    """

    positions: NDArray[np.float64]
    quaternions: NDArray[np.float64]
    camera_rows: NDArray[np.int32]
    offsets: NDArray[np.int64]
    keypoints_px: Floats
    points_in_world: Floats
    point_sigma_m: Floats
    distance_elsewhere: Halves
    keyframe_elsewhere: Numbers
    descriptors: NDArray[Any] | CheckedRows[Any]


@dataclass(frozen=True, slots=True)
class Places:
    """A map's features by place, computed from its arrays.

    `views` (v,) are the keyframes that are views of their own; `feature_rows` (m,) are the rows of their features, in
    the order of the numbers of the cells that the features lie in, `cell_keys` (m,).
    """

    views: Numbers
    feature_rows: Numbers
    cell_keys: Keys


@dataclass(frozen=True, slots=True)
class FileChecksums:
    """The checksum of a file, and for a large one those (b,) of its blocks of `block_bytes`, else None."""

    whole: int
    blocks: NDArray[np.uint64] | None
    block_bytes: int


# Before the names of the arrays of `SecondFeatures`.
SECOND = "second."
# Arrays with a row for each feature.
LARGE = frozenset(
    {
        "keypoints_px", "points_in_world", "point_sigma_m", "distance_elsewhere", "keyframe_elsewhere", "descriptors",
        "feature_rows", "cell_keys",
    }
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class MapArtifact:
    """A map in memory or memory-mapped; immutable.

    `places` is None in maps that were written without it, and in those that were not written yet. `checker` verifies
    the file of a map that has checksums, `index_checksums` are those of the file of its index. `second` are None for a
    map that was built without them.
    """

    metadata: MapMetadata
    arrays: MapArrays
    places: Places | None = None
    checker: BlockChecker | None = None
    index_checksums: FileChecksums | None = None
    second: SecondFeatures | None = None

    @property
    def is_damaged(self) -> bool:
        """Whether a part of the file that was read has another checksum than its contents."""
        return self.checker is not None and self.checker.is_damaged

    @property
    def keyframe_count(self) -> int:
        """How many keyframes the map has."""
        return len(self.arrays.positions)

    @property
    def feature_count(self) -> int:
        """How many features the map has."""
        return len(self.arrays.points_in_world)

    def pose(self, keyframe: int) -> Pose:
        """Return the `world_from_camera` of a keyframe."""
        return Pose.from_quaternion(self.arrays.positions[keyframe], self.arrays.quaternions[keyframe])

    def poses(self) -> list[Pose]:
        """Return the `world_from_camera` of all keyframes."""
        return [self.pose(keyframe) for keyframe in range(self.keyframe_count)]

    def axes(self) -> NDArray[np.float64]:
        """Return the optical axes (k, 3) of all keyframes in the world: the third columns of their rotations."""
        x, y, z, w = self.arrays.quaternions.T / np.linalg.norm(self.arrays.quaternions, axis=1)
        return np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)

    def camera(self, keyframe: int) -> Camera:
        """Return the camera of a keyframe."""
        return self.metadata.cameras[int(self.arrays.camera_rows[keyframe])]

    def rows(self, keyframe: int) -> slice:
        """Return the rows of a keyframe's features."""
        return slice(int(self.arrays.offsets[keyframe]), int(self.arrays.offsets[keyframe + 1]))

    def rows_of(self, keyframes: Sequence[int]) -> NDArray[np.intp]:
        """Return the rows (n,) of the features of some keyframes, one keyframe after the other."""
        offsets = self.arrays.offsets
        spans = [np.arange(offsets[keyframe], offsets[keyframe + 1]) for keyframe in keyframes]
        return np.concatenate([np.zeros(0, np.intp), *spans])

    def write(self, path: Path, index_checksums: FileChecksums | None = None) -> None:
        """Write the map to a file, with the checksums of the file of its index."""
        arrays = {name: getattr(self.arrays, name) for name in MapArrays.__slots__}
        if self.places is not None:
            arrays |= {name: getattr(self.places, name) for name in Places.__slots__}
        if self.second is not None:
            arrays |= {SECOND + name: getattr(self.second, name) for name in SecondFeatures.__slots__}
        write_packed(path, asdict(self.metadata) | _checksums_as_json(index_checksums), arrays)

    @staticmethod
    def open(path: Path) -> MapArtifact:
        """Memory-map a file that `write` made; raises `MapDamagedError`."""
        packed = read_packed(path, LARGE)
        try:
            arrays = dict(packed.arrays)
            has_places = Places.__slots__[0] in arrays
            places = Places(*(arrays.pop(name) for name in Places.__slots__)) if has_places else None
            second = {
                name.removeprefix(SECOND): arrays.pop(name) for name in [*arrays] if name.startswith(SECOND)
            }
            return MapArtifact(
                metadata=_metadata_from_json(packed.metadata),
                arrays=MapArrays(**arrays),
                places=places,
                checker=packed.checker,
                index_checksums=_checksums_from_json(packed.metadata),
                second=SecondFeatures(**second) if second else None,
            )
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise MapDamagedError(f"{path.name} is not a map artefact ({error}).") from error


def _checksums_as_json(checksums: FileChecksums | None) -> dict[str, Any]:
    if checksums is None:
        return {"index_checksum": None}
    values: dict[str, Any] = {"index_checksum": checksums.whole}
    if checksums.blocks is not None:
        values["index_blocks"] = checksums.blocks.astype("<u8").tobytes().hex()
        values["index_block_bytes"] = checksums.block_bytes
    return values


def _checksums_from_json(values: Mapping[str, Any]) -> FileChecksums | None:
    if values.get("index_checksum") is None:
        return None
    text = values.get("index_blocks")
    blocks = None if text is None else np.frombuffer(bytes.fromhex(text), "<u8").astype(np.uint64)
    return FileChecksums(values["index_checksum"], blocks, int(values.get("index_block_bytes", 0)))


def _metadata_from_json(values: Mapping[str, Any]) -> MapMetadata:
    cameras = tuple(
        Camera(c["model"], c["width"], c["height"], tuple(c["params"])) for c in values["cameras"]
    )
    return MapMetadata(
        features=values["features"],
        descriptor_sha256=values["descriptor_sha256"],
        descriptor_size=values["descriptor_size"],
        cameras=cameras,
        keyframe_names=tuple(values["keyframe_names"]),
        position_sigma_m=values["position_sigma_m"],
        orientation_sigma_deg=values["orientation_sigma_deg"],
        lens_sigmas=tuple(values.get("lens_sigmas", [0.0] * len(cameras))),
        # Maps that don't say it were made as if it did.
        z_up=values.get("z_up", True),
        has_scale=values.get("has_scale", True),
    )
