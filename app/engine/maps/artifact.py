"""A map version's features: one packed file, memory-mapped and shared by all processes.

Layout: the magic, the header's length (8 bytes, little endian), a JSON header (metadata, and name, dtype, shape
and offset of each array), then the arrays, each aligned to 64 bytes.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.second_features import SecondFeatures
from app.errors import RoomfixError
from app.geometry.camera import Camera
from app.geometry.lens import Lens
from app.geometry.se3 import Pose

MAGIC = b"RFMAP002"
ALIGNMENT = 64
# Before the names of the arrays of `SecondFeatures`.
SECOND = "second."


class MapArtifactError(RoomfixError):
    """A file that is not a map artefact, or one that is cut short."""

    code = "damaged_map"


@dataclass(frozen=True, slots=True, kw_only=True)
class MapMetadata:
    """What a map was made with: feature method, model of the global descriptor, cameras.

    `position_sigma_m` and `orientation_sigma_deg` are the error that frames of its own scan have in it: what the
    map adds to the error of any pose. `lens_sigmas` are how well the lens of each camera is known where the scan
    didn't state it but showed it, 0 where it is as stated. `z_up` says whether the world's z axis is known to point up.
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
    keypoints_px: NDArray[np.float32]
    points_in_world: NDArray[np.float32]
    point_sigma_m: NDArray[np.float32]
    distance_elsewhere: NDArray[np.float16]
    keyframe_elsewhere: NDArray[np.int32]
    descriptors: NDArray[Any]


@dataclass(frozen=True, slots=True)
class MapArtifact:
    """A map in memory or memory-mapped; immutable. `second` are None for a map that was built without them."""

    metadata: MapMetadata
    arrays: MapArrays
    second: SecondFeatures | None = None

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

    def camera(self, keyframe: int) -> Camera:
        """Return the camera of a keyframe."""
        return self.metadata.cameras[int(self.arrays.camera_rows[keyframe])]

    def rows(self, keyframe: int) -> slice:
        """Return the rows of a keyframe's features."""
        return slice(int(self.arrays.offsets[keyframe]), int(self.arrays.offsets[keyframe + 1]))

    def spans(self, keyframes: Sequence[int]) -> list[slice]:
        """Return the rows of each keyframe's features."""
        offsets = self.arrays.offsets
        return [slice(int(offsets[keyframe]), int(offsets[keyframe + 1])) for keyframe in keyframes]

    def rows_of(self, keyframes: Sequence[int]) -> NDArray[np.intp]:
        """Return the rows (n,) of the features of some keyframes, one keyframe after the other."""
        spans = [np.arange(span.start, span.stop) for span in self.spans(keyframes)]
        return np.concatenate([np.zeros(0, np.intp), *spans])

    def write(self, path: Path) -> None:
        """Write the map to a file."""
        arrays = {name: np.ascontiguousarray(getattr(self.arrays, name)) for name in MapArrays.__slots__}
        if self.second is not None:
            second = {SECOND + name: getattr(self.second, name) for name in SecondFeatures.__slots__}
            arrays |= {name: np.ascontiguousarray(array) for name, array in second.items()}
        header = {"metadata": _metadata_to_json(self.metadata), "arrays": _table(arrays)}
        text = json.dumps(header, separators=(",", ":")).encode()
        start = _aligned(len(MAGIC) + 8 + len(text))
        with path.open("wb") as file:
            file.write(MAGIC + len(text).to_bytes(8, "little") + text)
            for name, array in arrays.items():
                file.seek(start + header["arrays"][name]["offset"])
                file.write(array.tobytes())
            file.truncate(max(file.tell(), start))

    @staticmethod
    def open(path: Path) -> MapArtifact:
        """Memory-map a file that `write` made; raises `MapArtifactError`."""
        try:
            data = np.memmap(path, dtype=np.uint8, mode="r")
            length = int.from_bytes(bytes(data[8:16]), "little")
            if bytes(data[:8]) != MAGIC or 16 + length > len(data):
                raise MapArtifactError(f"{path.name} is not a map artefact.")
            header = json.loads(bytes(data[16 : 16 + length]))
            start = _aligned(16 + length)
            arrays = {name: _view(data, start, entry) for name, entry in header["arrays"].items()}
            second = {
                name.removeprefix(SECOND): arrays.pop(name) for name in [*arrays] if name.startswith(SECOND)
            }
            return MapArtifact(
                _metadata_from_json(header["metadata"]),
                MapArrays(**arrays),
                SecondFeatures(**second) if second else None,
            )
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise MapArtifactError(f"{path.name} is not a map artefact ({error}).") from error


def _aligned(offset: int) -> int:
    return -(-offset // ALIGNMENT) * ALIGNMENT


def _table(arrays: Mapping[str, NDArray[Any]]) -> dict[str, dict[str, Any]]:
    table, offset = {}, 0
    for name, array in arrays.items():
        table[name] = {"dtype": array.dtype.str, "shape": list(array.shape), "offset": offset}
        offset = _aligned(offset + array.nbytes)
    return table


def _view(data: NDArray[np.uint8], start: int, entry: Mapping[str, Any]) -> NDArray[Any]:
    dtype, shape = np.dtype(entry["dtype"]), tuple(entry["shape"])
    first = start + entry["offset"]
    size = int(np.prod(shape)) * dtype.itemsize
    if min((*shape, entry["offset"])) < 0 or first + size > len(data):
        raise MapArtifactError("The map artefact is cut short.")
    return np.asarray(data[first : first + size].view(dtype).reshape(shape))


def _metadata_to_json(metadata: MapMetadata) -> dict[str, Any]:
    return asdict(metadata)


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
    )
