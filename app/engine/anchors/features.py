"""What is kept of a picture for positioning by anchors: A-KAZE and XFeat features, and the former's visual words."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from app.geometry.camera import Camera
from app.vision.edges import down_in_picture
from app.vision.features import LocalFeatureExtractor, LocalFeatures
from app.vision.images import Gray, Rgb, shrink, to_gray
from app.vision.inverted_file import InvertedFile
from app.vision.local_features import FULL_SIDE_PX, Akaze, XFeat
from app.vision.matching import Unit, to_unit_vectors
from app.vision.vocabulary import Vocabulary, Words

# With twice the features of a map's keyframes three pairs in four at wide angles agree on a pose, with 1000 two.
XFEAT_FEATURES, TURNED_FEATURES, PHONE_SIDE_PX = 2000, 2300, 640
# A smaller picture is enlarged by as much, or less; beyond that it shows nothing more.
MAX_ENLARGED = 2.0
# A monitoring camera's lens is wider and its picture larger: at this size a POI has about the pixels that it has in a
# phone's picture of 640 (measured on the demonstration venue: docs/anchors.md).
MONITOR_SIDE_PX, MONITOR_FEATURES = 960, 3000
# A lens wider still, a fisheye, shows a POI so large only in a larger picture: where the focal length at the first
# size is below the limit.
WIDE_SIDE_PX, MIN_FOCAL_PX = 1280, 420.0
# Pictures are alike by the matches among so many of their strongest XFeat features, the monitoring camera's and the
# phone's, that are at least so similar.
STRONGEST_OF_MONITOR, STRONGEST_OF_PHONE, ALIKE = 600, 400, 0.82
AKAZE_FEATURES = 1000
AKAZE_RATIO = 0.85
# A picture rolled less is taken as it is; nearer to its border a turned one has false corners.
MIN_ROLL_DEG, BORDER_PX = 12.0, 6.0
NO_ROWS = np.zeros(0, np.intp)
# A query's own words are not kept: each of its features is looked up under several.
NO_WORDS = np.zeros(0, np.int64)
NO_LENGTHS = np.zeros(0, np.float32)
NO_DOWN = np.zeros(0)


@dataclass(frozen=True, kw_only=True)
class AnchorFeatures:
    """The features of one picture. `akaze` finds the anchor and bears turned phones; `xfeat` bears wide angles;
    `words` (n,) are the visual words of the former. Of a calibrated camera `*_length_m` says how far along its ray
    each feature lies by the map, NaN where the map doesn't tell. `down` (3,) is the vertical in camera axes, where the
    edges in a monitoring camera's picture show it."""

    akaze: LocalFeatures
    xfeat: LocalFeatures
    words: Words
    akaze_length_m: NDArray[np.float32] | None = None
    xfeat_length_m: NDArray[np.float32] | None = None
    down: NDArray[np.float64] | None = None

    @cached_property
    def xfeat_unit(self) -> Unit:
        """The XFeat descriptors as unit vectors."""
        return to_unit_vectors(self.xfeat.descriptors, False)

    def pack(self) -> bytes:
        """Return the features as bytes, XFeat at half precision."""
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
        )
        return buffer.getvalue()

    @staticmethod
    def unpack(data: bytes) -> AnchorFeatures | None:
        """Return what `pack` has packed, None for what an earlier version did: the camera's next frame replaces it."""
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
            )


class AnchorDescriber:
    """Extracts the features of pictures. Safe to share between threads."""

    def __init__(self, vocabulary: Vocabulary | None = None) -> None:
        self.akaze: LocalFeatureExtractor = Akaze(FULL_SIDE_PX, AKAZE_FEATURES)
        self.xfeat: LocalFeatureExtractor = XFeat(XFEAT_FEATURES, PHONE_SIDE_PX)
        # The canvas of a turned picture is larger than it, up to its diagonal; the picture in it must not get smaller.
        # What it finds along the picture's border is left out.
        self.turned_xfeat: LocalFeatureExtractor = XFeat(TURNED_FEATURES, 2 * PHONE_SIDE_PX)
        self.monitor_xfeat: LocalFeatureExtractor = XFeat(MONITOR_FEATURES, MONITOR_SIDE_PX)
        self.wide_xfeat: LocalFeatureExtractor = XFeat(MONITOR_FEATURES, WIDE_SIDE_PX)
        self.vocabulary = vocabulary or Vocabulary.open()

    def describe(self, rgb: Rgb, camera: Camera) -> AnchorFeatures:
        """Return all features of a monitoring camera's RGB image (height, width, 3)."""
        gray = to_gray(rgb)
        akaze = self.akaze.extract(gray)
        shrunk = min(1.0, MONITOR_SIDE_PX / max(gray.shape))
        xfeat = self.wide_xfeat if shrunk * camera.focal_px < MIN_FOCAL_PX else self.monitor_xfeat
        down = down_in_picture(gray, camera)
        return AnchorFeatures(akaze=akaze, xfeat=xfeat.extract(gray), words=self.words_of(akaze), down=down)

    def words_of(self, akaze: LocalFeatures) -> Words:
        """Return the visual words (n,) of A-KAZE features."""
        return self.vocabulary.words_of(np.asarray(akaze.descriptors, dtype=np.uint8))

    def alike_by_words(self, monitors: Sequence[AnchorFeatures], akaze: LocalFeatures) -> NDArray[np.float64]:
        """Return how much a picture with these A-KAZE features looks like each monitoring frame, (m,)."""
        pictures = [(one.words, np.asarray(one.akaze.descriptors, dtype=np.uint8)) for one in monitors]
        return InvertedFile(self.vocabulary, pictures).scores(np.asarray(akaze.descriptors, dtype=np.uint8))

    def upright_xfeat(self, gray: Gray, roll_deg: float) -> LocalFeatures:
        """Return XFeat's features of an image (height, width) that must be turned counter-clockwise by `roll_deg` to
        be upright, as the network wants it; the keypoints are in pixels of the image as it is."""
        small, scale = _phone_sized(gray)
        if abs(roll_deg) < MIN_ROLL_DEG:
            features = self.xfeat.extract(small)
            points = (features.keypoints_px + 0.5) / scale - 0.5
            return LocalFeatures(points.astype(np.float32), features.descriptors)
        height, width = small.shape
        turn = cv2.getRotationMatrix2D((0.5 * (width - 1), 0.5 * (height - 1)), roll_deg, 1.0)
        cos, sin = np.abs(turn[0, :2])
        size = int(np.ceil(width * cos + height * sin)), int(np.ceil(width * sin + height * cos))
        turn[:, 2] = turn[:, 2] + 0.5 * (np.array(size, dtype=np.float64) - [width, height])
        # Grey instead of black outside the picture makes fewer corners along its border.
        turned = cv2.warpAffine(small, turn, size, borderValue=128.0)
        features = self.turned_xfeat.extract(np.asarray(turned, dtype=np.uint8))
        back = cv2.invertAffineTransform(turn)
        points = features.keypoints_px @ back[:, :2].T + back[:, 2]
        inside = ((points > BORDER_PX) & (points < np.array([width, height]) - 1 - BORDER_PX)).all(axis=1)
        rows = np.flatnonzero(inside)[:XFEAT_FEATURES]
        points = (points[rows] + 0.5) / scale - 0.5
        return LocalFeatures(points.astype(np.float32), features.descriptors[rows])


def _phone_sized(gray: Gray) -> tuple[Gray, float]:
    """Return an image (height, width) at the size at which XFeat sees phones', and the scale: what a small one shows
    must be as large there as in the monitoring frame."""
    scale = PHONE_SIDE_PX / max(gray.shape)
    if scale <= 1.0:
        return shrink(gray, PHONE_SIDE_PX)
    scale = min(scale, MAX_ENLARGED)
    enlarged = cv2.resize(gray, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    return np.asarray(enlarged, dtype=np.uint8), scale


@dataclass(frozen=True, slots=True)
class PixelMatches:
    """Matches of a monitoring camera's picture (n, 2) with a phone's (n, 2), in pixels of each, and how far along the
    monitoring camera's ray each lies, (n,) in metres, NaN where that is not known."""

    monitor_px: NDArray[np.float64]
    phone_px: NDArray[np.float64]
    length_m: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.monitor_px)

    def take(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> PixelMatches:
        """Return the matches of a mask (n,) or of rows."""
        return PixelMatches(self.monitor_px[rows], self.phone_px[rows], self.length_m[rows])

    def with_more(self, other: PixelMatches) -> PixelMatches:
        """Return these and others."""
        return PixelMatches(
            np.concatenate([self.monitor_px, other.monitor_px]),
            np.concatenate([self.phone_px, other.phone_px]),
            np.concatenate([self.length_m, other.length_m]),
        )


def match_akaze(monitor: AnchorFeatures, phone: AnchorFeatures) -> PixelMatches:
    """Return the A-KAZE features of two pictures that are each other's nearest and pass the ratio test."""
    ours, theirs = monitor.akaze.descriptors, phone.akaze.descriptors
    if len(ours) == 0 or len(theirs) < 2:
        return _matches(monitor.akaze, phone.akaze, NO_ROWS, NO_ROWS, monitor.akaze_length_m)
    # Counting bits takes a fraction of the time of a matrix product of so many signs.
    distances, two = cv2.batchDistance(ours, theirs, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=2)
    _, back = cv2.batchDistance(theirs, ours, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=1)
    rows, nearest = np.arange(len(ours)), two[:, 0].astype(np.intp)
    keep = (back[nearest, 0] == rows) & (distances[:, 0] < AKAZE_RATIO * distances[:, 1])
    a, b = rows[keep], nearest[keep]
    return _matches(monitor.akaze, phone.akaze, a, b, monitor.akaze_length_m)


def match_xfeat(monitor: AnchorFeatures, phone: AnchorFeatures) -> PixelMatches:
    """Return the XFeat features of two pictures that are each other's nearest."""
    if min(len(monitor.xfeat_unit), len(phone.xfeat_unit)) == 0:
        return _matches(monitor.xfeat, phone.xfeat, NO_ROWS, NO_ROWS, monitor.xfeat_length_m)
    similarity = monitor.xfeat_unit @ phone.xfeat_unit.T
    a, b, _ = _mutual(similarity)
    return _matches(monitor.xfeat, phone.xfeat, a, b, monitor.xfeat_length_m)


def likeness(monitor: AnchorFeatures, phone: AnchorFeatures) -> int:
    """Return how many of the strongest XFeat features of two pictures are each other's nearest and similar."""
    similarity = monitor.xfeat_unit[:STRONGEST_OF_MONITOR] @ phone.xfeat_unit[:STRONGEST_OF_PHONE].T
    if similarity.size == 0:
        return 0
    return int(np.count_nonzero(_mutual(similarity)[2] > ALIKE))


def _mutual(similarity: Unit) -> tuple[NDArray[np.intp], NDArray[np.intp], Unit]:
    """Return rows, columns and values of a matrix (n, m) that are the largest of their row and of their column."""
    nearest = similarity.argmax(axis=1)
    values = similarity[np.arange(len(nearest)), nearest]
    # Comparing with the columns' maxima is many times faster than finding where these are.
    rows = np.flatnonzero(values >= similarity.max(axis=0)[nearest])
    return rows, nearest[rows], values[rows]


def _matches(
    monitor: LocalFeatures,
    phone: LocalFeatures,
    a: NDArray[np.intp],
    b: NDArray[np.intp],
    length_m: NDArray[np.float32] | None,
) -> PixelMatches:
    return PixelMatches(
        monitor.keypoints_px[a].astype(np.float64),
        phone.keypoints_px[b].astype(np.float64),
        np.full(len(a), np.nan) if length_m is None else length_m[a].astype(np.float64),
    )
