"""Feature matches between a monitoring frame and a phone image."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.engine.anchors.features import AnchorFeatures
from app.limits import limit
from app.vision.features import LocalFeatures
from app.vision.matching import Unit

NO_ROWS = np.zeros(0, np.intp)


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorMatchingOptions:
    """When features of two images match, and when two images are alike."""

    akaze_ratio: float = limit(
        0.85,
        "Largest ratio of the Hamming distances of the nearest and the second nearest A-KAZE descriptor.",
        chosen="By hand; no measurement is recorded.",
    )
    strongest_of_monitor: int = limit(
        600,
        "Number of the monitoring frame's strongest XFeat features that count for the likeness of two images.",
        chosen="By hand; no measurement is recorded.",
    )
    strongest_of_phone: int = limit(
        400,
        "Number of the phone image's strongest XFeat features that count for the likeness of two images.",
        chosen="By hand; no measurement is recorded.",
    )
    min_similarity: float = limit(
        0.82,
        "Least scalar product of two unit XFeat descriptors that count for the likeness of two images.",
        chosen="By hand; no measurement is recorded.",
    )


OPTIONS = AnchorMatchingOptions()


@dataclass(frozen=True, slots=True)
class PixelMatches:
    """Matches of a monitoring frame with a phone image: the pixels (n, 2) in both, and the distances (n,) in metres
    along the monitoring camera's rays by the map, NaN where they are not known."""

    monitor_px: NDArray[np.float64]
    phone_px: NDArray[np.float64]
    length_m: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.monitor_px)

    def take(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> PixelMatches:
        """Return the matches of a mask (n,) or of rows."""
        return PixelMatches(self.monitor_px[rows], self.phone_px[rows], self.length_m[rows])

    def with_more(self, other: PixelMatches) -> PixelMatches:
        """Return these matches and those of `other`."""
        return PixelMatches(
            np.concatenate([self.monitor_px, other.monitor_px]),
            np.concatenate([self.phone_px, other.phone_px]),
            np.concatenate([self.length_m, other.length_m]),
        )


def match_akaze(monitor: AnchorFeatures, phone: AnchorFeatures) -> PixelMatches:
    """Return the matches of A-KAZE features that are mutual nearest neighbours and pass the ratio test."""
    ours, theirs = monitor.akaze.descriptors, phone.akaze.descriptors
    if len(ours) == 0 or len(theirs) < 2:
        return _matches(monitor.akaze, phone.akaze, NO_ROWS, NO_ROWS, monitor.akaze_length_m)
    # Hamming distances take a fraction of the time of a matrix product of unit vectors.
    distances, two = cv2.batchDistance(ours, theirs, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=2)
    _, back = cv2.batchDistance(theirs, ours, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=1)
    rows, nearest = np.arange(len(ours)), two[:, 0].astype(np.intp)
    keep = (back[nearest, 0] == rows) & (distances[:, 0] < OPTIONS.akaze_ratio * distances[:, 1])
    a, b = rows[keep], nearest[keep]
    return _matches(monitor.akaze, phone.akaze, a, b, monitor.akaze_length_m)


def match_xfeat(monitor: AnchorFeatures, phone: AnchorFeatures) -> PixelMatches:
    """Return the matches of XFeat features that are mutual nearest neighbours."""
    if min(len(monitor.xfeat_unit), len(phone.xfeat_unit)) == 0:
        return _matches(monitor.xfeat, phone.xfeat, NO_ROWS, NO_ROWS, monitor.xfeat_length_m)
    similarity = monitor.xfeat_unit @ phone.xfeat_unit.T
    a, b, _ = _mutual(similarity)
    return _matches(monitor.xfeat, phone.xfeat, a, b, monitor.xfeat_length_m)


def likeness(monitor: AnchorFeatures, phone: AnchorFeatures) -> int:
    """Return the number of mutual nearest neighbours with similar descriptors among the strongest XFeat features."""
    ours = monitor.xfeat_unit[: OPTIONS.strongest_of_monitor]
    theirs = phone.xfeat_unit[: OPTIONS.strongest_of_phone]
    similarity = ours @ theirs.T
    if similarity.size == 0:
        return 0
    return int(np.count_nonzero(_mutual(similarity)[2] > OPTIONS.min_similarity))


def _mutual(similarity: Unit) -> tuple[NDArray[np.intp], NDArray[np.intp], Unit]:
    """Return rows, columns and values of a matrix (n, m) that are the largest of their row and of their column."""
    nearest = similarity.argmax(axis=1)
    values = similarity[np.arange(len(nearest)), nearest]
    # The maximum of each column is many times faster to compute than its position.
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
