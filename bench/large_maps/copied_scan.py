"""A long scan made of copies of a short one, none of which looks like another.

Each copy is elsewhere, and what is described of its pictures has its numbers in another order, as in `tiling`.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.vision_models import VisionModels
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.importers.frames import Frame, Scan
from app.vision.features import LocalFeatureExtractor, LocalFeatures
from app.vision.global_descriptor import GlobalDescriptor
from app.vision.images import Gray, Rgb
from bench.large_maps.tiling import SPACING_M, order_of_copy, signs_of_copy


class CopyOfThread(threading.local):
    """Which copy the picture is of that a thread has read last."""

    number = 0


class CopiedScan:
    """A scan several times; `copy` learns of each picture that is read (see `FrameSource`)."""

    def __init__(self, scan: Scan, copies: int, copy: CopyOfThread) -> None:
        self._scan, self._copy = scan, copy
        self._own = {
            f"{number}/{frame.name}": (number, frame) for number in range(copies) for frame in scan.frames
        }
        self.frames = tuple(_moved(name, number, frame) for name, (number, frame) in self._own.items())
        self.camera: Camera = scan.camera
        self.discarded: Mapping[str, tuple[str, ...]] = {}
        self.gravity, self.notes = scan.gravity, scan.notes
        self.has_depth, self.has_scale = scan.has_depth, scan.has_scale

    def color_bytes(self, frame: Frame) -> bytes:
        """Return the colour image's file contents."""
        self._copy.number, own = self._own[frame.name]
        return self._scan.color_bytes(own)

    def depth_m(self, frame: Frame) -> NDArray[np.float32]:
        """Return the z-depth (height, width) in metres."""
        return self._scan.depth_m(self._own[frame.name][1])


def _moved(name: str, number: int, frame: Frame) -> Frame:
    place = np.array([number % 32, number // 32, 0.0]) * SPACING_M
    pose = frame.scan_from_camera
    return replace(frame, name=name, scan_from_camera=Pose(pose.rotation, pose.translation + place))


@dataclass(frozen=True, slots=True)
class CopiedExtractor:
    """An extractor whose descriptors are in the order of the copy that the thread works on."""

    inner: LocalFeatureExtractor
    copy: CopyOfThread

    def extract(self, gray: Gray) -> LocalFeatures:
        """Return the features of a grey image (height, width)."""
        found = self.inner.extract(gray)
        order = order_of_copy(self.copy.number, found.descriptors.shape[1])
        return replace(found, descriptors=found.descriptors[:, order])

    def for_faint_images(self) -> None:
        """Pictures get no second look: what the first one costs is measured."""

    def __getattr__(self, name: str) -> object:
        return getattr(self.inner, name)


@dataclass(frozen=True, slots=True)
class CopiedDescriptor:
    """A global descriptor that has the order and the signs of the copy that the thread works on."""

    inner: GlobalDescriptor
    copy: CopyOfThread

    def describe(self, rgb: Rgb) -> NDArray[np.float32]:
        """Return the descriptor (d,) of an image (height, width, 3)."""
        found = self.inner.describe(rgb)
        number, size = self.copy.number, len(found)
        return np.asarray(found[order_of_copy(number, size)] * signs_of_copy(number, size))

    def __getattr__(self, name: str) -> object:
        return getattr(self.inner, name)


class CopiedModels(VisionModels):
    """Models that describe the pictures of each copy in its own way."""

    def __init__(self, copy: CopyOfThread) -> None:
        super().__init__()
        self._copy = copy

    def extractor(self, name: str) -> LocalFeatureExtractor:
        """Return the extractor of that name."""
        return CopiedExtractor(super().extractor(name), self._copy)  # type: ignore[return-value]

    @property
    def global_descriptor(self) -> GlobalDescriptor:
        """The global descriptor."""
        return CopiedDescriptor(super().global_descriptor, self._copy)  # type: ignore[return-value]
