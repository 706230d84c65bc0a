"""The description of an image for positioning by anchors: A-KAZE features with their visual words, XFeat features."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from app.engine.anchors.poi_sweep import RegionDescriptors
from app.geometry.camera import Camera
from app.limits import limit
from app.vision.dense_descriptors import DenseDescriptors
from app.vision.edges import down_in_picture
from app.vision.features import LocalFeatureExtractor, LocalFeatures
from app.vision.images import Gray, Rgb, shrink, to_gray
from app.vision.inverted_file import InvertedFile
from app.vision.local_features import FULL_SIDE_PX, Akaze, XFeat
from app.vision.matching import Unit, to_unit_vectors
from app.vision.vocabulary import Vocabulary, Words

# A phone image has no words of its own: each of its features is looked up under several.
NO_WORDS = np.zeros(0, np.int64)
NO_LENGTHS = np.zeros(0, np.float32)
NO_DOWN = np.zeros(0)
NO_POINTS = np.zeros((0, 2), np.float32)
NO_DESCRIPTORS = np.zeros((0, XFeat.descriptor_size), np.float32)


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorFeatureOptions:
    """At which image sizes features are extracted, and how many."""

    akaze_features: int = limit(
        1000, "Largest number of A-KAZE features of an image.", chosen="By hand; no measurement is recorded."
    )
    phone_features: int = limit(
        2000,
        "Largest number of XFeat features of a phone image.",
        chosen="Measured on rendered pairs at wide angles: with 2000 three pairs in four agree on a pose, with 1000 "
        "two in four; the command is not recorded.",
    )
    rotated_features: int = limit(
        2300,
        "Largest number of XFeat features of a rotated phone image, before those at its border are dropped.",
        chosen="By hand: about `phone_features` are left.",
    )
    phone_side_px: int = limit(
        640,
        "Longer side of the phone image from which XFeat features are extracted.",
        chosen="By hand; no measurement is recorded.",
    )
    max_enlargement_ratio: float = limit(
        2.0,
        "Largest factor by which a smaller phone image is enlarged.",
        chosen="By hand: a larger factor shows no more detail.",
    )
    monitor_side_px: int = limit(
        960,
        "Longer side of the monitoring frame from which XFeat features are extracted.",
        chosen="Measured on the demonstration venue (docs/anchors.md): at this size a POI is about as large as in a "
        "phone image of 640 pixels, for monitoring cameras have wider lenses.",
    )
    monitor_features: int = limit(
        3000,
        "Largest number of XFeat features of a monitoring frame.",
        chosen="By hand; no measurement is recorded.",
    )
    wide_side_px: int = limit(
        1280,
        "Longer side of the monitoring frame of a very wide lens, such as a fisheye.",
        chosen="By hand: a POI is as large only in a larger image.",
    )
    min_focal_px: float = limit(
        420.0,
        "Focal length at `monitor_side_px` below which a lens is very wide.",
        chosen="By hand; no measurement is recorded.",
    )
    min_roll_deg: float = limit(
        12.0,
        "Roll of a phone from which its image is rotated upright before XFeat sees it.",
        chosen="By hand; no measurement is recorded.",
    )
    region_points: int = limit(
        9,
        "Points along each side of a POI's region at which descriptors are kept for the sweep of its length.",
        chosen="By hand: of a region of a tenth of the frame, one for each cell of the network.",
    )
    border_px: float = limit(
        6.0,
        "Distance from the border of a rotated image within which features are dropped.",
        chosen="By hand: the border itself makes false corners there.",
    )


OPTIONS = AnchorFeatureOptions()


@dataclass(frozen=True, kw_only=True)
class AnchorFeatures:
    """The features of one image.

    `akaze` features are robust to a phone's roll and retrieve the anchor, by their visual words `words` (n,); `xfeat`
    features are robust to wide angles between the views. `*_length_m` are the distances (n,) of the features along
    their rays by the map, NaN where the map doesn't know them; None for a camera that is not calibrated. `down` (3,)
    is the vertical in camera axes, None where the edges in the monitoring frame don't show it. `regions` describes a
    monitoring frame in the regions of its POIs, `dense` a phone's image everywhere.
    """

    akaze: LocalFeatures
    xfeat: LocalFeatures
    words: Words
    akaze_length_m: NDArray[np.float32] | None = None
    xfeat_length_m: NDArray[np.float32] | None = None
    down: NDArray[np.float64] | None = None
    regions: RegionDescriptors | None = None
    dense: DenseDescriptors | None = None

    @cached_property
    def xfeat_unit(self) -> Unit:
        """The XFeat descriptors as unit vectors."""
        return to_unit_vectors(self.xfeat.descriptors, False)

    def pack(self) -> bytes:
        """Return the features as bytes, XFeat at half precision; those of a phone's image everywhere are left out."""
        buffer = io.BytesIO()
        np.savez(
            buffer,
            akaze_px=self.akaze.keypoints_px,
            akaze=self.akaze.descriptors,
            xfeat_px=self.xfeat.keypoints_px,
            xfeat=self.xfeat.descriptors.astype(np.float16),
            akaze_words=self.words.astype(np.uint16),
            akaze_length_m=NO_LENGTHS if self.akaze_length_m is None else self.akaze_length_m,
            xfeat_length_m=NO_LENGTHS if self.xfeat_length_m is None else self.xfeat_length_m,
            down=NO_DOWN if self.down is None else self.down,
            regions_px=NO_POINTS if self.regions is None else self.regions.points_px,
            regions=NO_DESCRIPTORS if self.regions is None else self.regions.descriptors.astype(np.float16),
        )
        return buffer.getvalue()

    @staticmethod
    def unpack(data: bytes) -> AnchorFeatures | None:
        """Return the features that `pack` packed, None for the format of an earlier version.

        The camera's next frame replaces such features.
        """
        with np.load(io.BytesIO(data)) as arrays:
            if "akaze_words" not in arrays:
                return None
            return AnchorFeatures(
                akaze=LocalFeatures(arrays["akaze_px"], arrays["akaze"]),
                xfeat=LocalFeatures(arrays["xfeat_px"], arrays["xfeat"].astype(np.float32)),
                words=arrays["akaze_words"].astype(np.int64),
                akaze_length_m=arrays["akaze_length_m"] if len(arrays["akaze_length_m"]) else None,
                xfeat_length_m=arrays["xfeat_length_m"] if len(arrays["xfeat_length_m"]) else None,
                down=arrays["down"] if len(arrays.get("down", NO_DOWN)) else None,
                # Frames of an earlier version have none, until the camera's next frame.
                regions=RegionDescriptors(arrays["regions_px"], arrays["regions"].astype(np.float32))
                if len(arrays.get("regions_px", NO_POINTS))
                else None,
            )


class AnchorDescriber:
    """Extracts the features of images. Safe to share between threads."""

    def __init__(self, vocabulary: Vocabulary | None = None) -> None:
        self.akaze: LocalFeatureExtractor = Akaze(FULL_SIDE_PX, OPTIONS.akaze_features)
        self.xfeat = XFeat(OPTIONS.phone_features, OPTIONS.phone_side_px)
        # A rotated image needs a larger canvas, up to its diagonal, which must not be shrunk.
        self.rotated_xfeat = XFeat(OPTIONS.rotated_features, 2 * OPTIONS.phone_side_px)
        self.monitor_xfeat = XFeat(OPTIONS.monitor_features, OPTIONS.monitor_side_px)
        self.wide_xfeat = XFeat(OPTIONS.monitor_features, OPTIONS.wide_side_px)
        self.vocabulary = vocabulary or Vocabulary.open()

    def describe(
        self, rgb: Rgb, camera: Camera, regions_px: Sequence[NDArray[np.float64]] = ()
    ) -> AnchorFeatures:
        """Return all features of a monitoring camera's RGB image (height, width, 3).

        `regions_px` are the corners (n, 2) of its POIs' regions.
        """
        gray = to_gray(rgb)
        akaze = self.akaze.extract(gray)
        scale = min(1.0, OPTIONS.monitor_side_px / max(gray.shape))
        xfeat = self.wide_xfeat if scale * camera.focal_px < OPTIONS.min_focal_px else self.monitor_xfeat
        features, dense = xfeat.extract_dense(gray)
        return AnchorFeatures(
            akaze=akaze,
            xfeat=features,
            words=self.words_of(akaze),
            down=down_in_picture(gray, camera),
            regions=_described_regions(regions_px, dense),
        )

    def describe_phone(self, gray: Gray, akaze: LocalFeatures, roll_deg: float) -> AnchorFeatures:
        """Return all features of a phone's image (height, width), given its A-KAZE features; `roll_deg` is the
        counter-clockwise rotation that makes it upright."""
        xfeat, dense = self.upright_xfeat(gray, roll_deg)
        return AnchorFeatures(akaze=akaze, xfeat=xfeat, words=NO_WORDS, dense=dense)

    def words_of(self, akaze: LocalFeatures) -> Words:
        """Return the visual words (n,) of A-KAZE features."""
        return self.vocabulary.words_of(np.asarray(akaze.descriptors, dtype=np.uint8))

    def alike_by_words(self, monitors: Sequence[AnchorFeatures], akaze: LocalFeatures) -> NDArray[np.float64]:
        """Return the similarity (m,) by visual words of an image with these A-KAZE features to monitoring frames."""
        images = [(one.words, np.asarray(one.akaze.descriptors, dtype=np.uint8)) for one in monitors]
        return InvertedFile(self.vocabulary, images).scores(np.asarray(akaze.descriptors, dtype=np.uint8))

    def upright_xfeat(self, gray: Gray, roll_deg: float) -> tuple[LocalFeatures, DenseDescriptors]:
        """Return the XFeat features of an image (height, width), and its descriptors, after rotating it upright.

        `roll_deg` is the counter-clockwise rotation that makes it upright, as the network expects images. The
        keypoints are in pixels of the original image.
        """
        small, scale = _phone_sized(gray)
        offset = 0.5 * scale - 0.5
        resized = np.array([[scale, 0.0, offset], [0.0, scale, offset], [0.0, 0.0, 1.0]])
        if abs(roll_deg) < OPTIONS.min_roll_deg:
            features, dense = self.xfeat.extract_dense(small)
            points = (features.keypoints_px + 0.5) / scale - 0.5
            return LocalFeatures(points.astype(np.float32), features.descriptors), _after(dense, resized)
        height, width = small.shape
        rotation = cv2.getRotationMatrix2D((0.5 * (width - 1), 0.5 * (height - 1)), roll_deg, 1.0)
        cos, sin = np.abs(rotation[0, :2])
        size = int(np.ceil(width * cos + height * sin)), int(np.ceil(width * sin + height * cos))
        rotation[:, 2] = rotation[:, 2] + 0.5 * (np.array(size, dtype=np.float64) - [width, height])
        # Grey instead of black outside the image makes fewer corners along its border.
        rotated = cv2.warpAffine(small, rotation, size, borderValue=128.0)
        features, dense = self.rotated_xfeat.extract_dense(np.asarray(rotated, dtype=np.uint8))
        back = cv2.invertAffineTransform(rotation)
        points = features.keypoints_px @ back[:, :2].T + back[:, 2]
        inside = (points > OPTIONS.border_px) & (points < np.array([width, height]) - 1 - OPTIONS.border_px)
        rows = np.flatnonzero(inside.all(axis=1))[: OPTIONS.phone_features]
        points = (points[rows] + 0.5) / scale - 0.5
        kept = LocalFeatures(points.astype(np.float32), features.descriptors[rows])
        return kept, _after(dense, np.vstack([rotation, [0.0, 0.0, 1.0]]) @ resized)


def _after(dense: DenseDescriptors, change: NDArray[np.float64]) -> DenseDescriptors:
    """Return the descriptors of an image whose pixels `change` (3, 3) leads to those that were described."""
    first = np.vstack([dense.input_from_image, [0.0, 0.0, 1.0]])
    return replace(dense, input_from_image=(first @ change)[:2])


def _described_regions(
    regions_px: Sequence[NDArray[np.float64]], dense: DenseDescriptors
) -> RegionDescriptors | None:
    """Return the descriptors of a grid of points over each region's bounding box, None without regions."""
    steps = (np.arange(OPTIONS.region_points) + 0.5) / OPTIONS.region_points
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    points = [corners.min(axis=0) + grid * np.ptp(corners, axis=0) for corners in regions_px]
    if not points:
        return None
    inside = np.concatenate(points)
    inside = inside[dense.contains(inside)]
    return RegionDescriptors(inside.astype(np.float32), dense.at(inside))


def _phone_sized(gray: Gray) -> tuple[Gray, float]:
    """Return an image (height, width) at the size from which a phone's XFeat features are extracted, and the scale.

    A smaller image is enlarged, so that objects have about the size that they have in the monitoring frame.
    """
    scale = OPTIONS.phone_side_px / max(gray.shape)
    if scale <= 1.0:
        return shrink(gray, OPTIONS.phone_side_px)
    scale = min(scale, OPTIONS.max_enlargement_ratio)
    enlarged = cv2.resize(gray, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    return np.asarray(enlarged, dtype=np.uint8), scale
