"""Whether the scale of a path is the same before and after each of its steps, by points that are made on either side.

A bundle adjustment hides a scale that slides: what would contradict it is left out, or becomes two points. So points
are made of the matches anew, each by the pictures of one side of a step, and their depths compared.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from app.engine.mapping.structure.matches import Pair, Rows
from app.engine.mapping.structure.reconstruction import Reconstruction
from app.geometry.camera import tangent_of_px
from app.geometry.triangulation import homogeneous
from app.limits import limit
from app.vision.features import LocalFeatures

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class StepOptions:
    """Which points tell the scale on one side of a step."""

    window: int = limit(
        12,
        "Pictures on each side of a step of whose matches points are made.",
        chosen="By hand: a turn on the spot.",
    )
    min_angle_deg: float = limit(
        0.5,
        "Least angle between the rays to a point on one side.",
        chosen="As of the points of a joined path.",
    )
    max_error_px: float = limit(
        2.0,
        "Largest distance of a point from a feature on its side, at the focal length of reference.",
        chosen="By hand: what is further off is a false match.",
    )
    noise_px: float = limit(
        0.5, "Standard deviation of a feature, for the weight of a depth.", chosen="By hand."
    )
    least_sigma: float = limit(
        0.02, "Least standard deviation of the logarithm of a ratio of depths.", chosen="By hand."
    )


OPTIONS = StepOptions()


@dataclass(frozen=True, slots=True)
class Step:
    """What carries the scale from one picture to the next: points with a depth on both sides that agree, the logarithm
    of the scale after over that before by their median, and its standard deviation."""

    points: int
    log_ratio: float
    sigma: float


UNKNOWN = Step(0, 0.0, np.inf)


@dataclass(frozen=True, slots=True)
class _Tracks:
    """Views of points one after the other: `first` (t + 1,) are the bounds of each point's, sorted by picture."""

    rows: Rows
    centres: Array
    rays: Array
    first: Rows


def scale_steps(
    part: Reconstruction, features: Sequence[LocalFeatures], matches: Mapping[Pair, Rows]
) -> dict[int, Step]:
    """Return the step after each picture of a part but the last, by matches of pictures that are near in time."""
    tracks = _tracks(part, features, matches)
    lower, middle, upper = _splits(tracks)
    before, after = _points(tracks, lower, middle), _points(tracks, middle, upper)
    centres = tracks.centres[middle - 1]
    known = before[1] & after[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.log(
            np.linalg.norm(after[0] - centres, axis=1) / np.linalg.norm(before[0] - centres, axis=1)
        )
    sigmas = tangent_of_px(OPTIONS.noise_px) * np.hypot(1 / before[2], 1 / after[2])
    of_step = defaultdict(list)
    for number in np.flatnonzero(known & np.isfinite(ratios)):
        for row in range(tracks.rows[middle[number] - 1], tracks.rows[middle[number]]):
            of_step[row].append((ratios[number], sigmas[number]))
    known_rows = sorted(part.poses)
    return {a: _step(np.array(of_step[a])) if of_step[a] else UNKNOWN for a, _ in pairwise(known_rows)}


def _step(seen: Array) -> Step:
    ratios, sigmas = seen[:, 0], np.hypot(seen[:, 1], OPTIONS.least_sigma)
    weights = sigmas**-2
    order = np.argsort(ratios)
    total = np.cumsum(weights[order])
    median = float(ratios[order[np.searchsorted(total, total[-1] / 2)]])
    agree = np.abs(ratios - median) < 3 * sigmas
    # A median's standard deviation is by a quarter larger than a mean's.
    return Step(int(agree.sum()), median, float(1.25 / np.sqrt(weights[agree].sum())))


def _tracks(part: Reconstruction, features: Sequence[LocalFeatures], matches: Mapping[Pair, Rows]) -> _Tracks:
    """Return the points that matches of the part's pictures chain together, those with four views and more."""
    counts = np.array([len(own) for own in features])
    start = np.concatenate([[0], np.cumsum(counts)])
    pairs = [
        np.stack([start[i] + rows[:, 0], start[j] + rows[:, 1]], axis=1)
        for (i, j), rows in matches.items()
        if i in part.poses and j in part.poses
    ]
    links = np.concatenate([np.zeros((0, 2), np.intp), *pairs])
    graph = coo_matrix((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(start[-1], start[-1]))
    _, labels = connected_components(graph, directed=False)
    picture = np.repeat(np.arange(len(counts)), counts)
    used = np.unique(links)
    used = used[np.lexsort((picture[used], labels[used]))]
    bounds = np.concatenate([[0], np.flatnonzero(np.diff(labels[used])) + 1, [len(used)]])
    kept = [used[a:b] for a, b in pairwise(bounds) if b - a >= 4 and (np.diff(picture[used[a:b]]) > 0).all()]
    views = np.concatenate([np.zeros(0, np.intp), *kept])
    rows = picture[views]
    rays, centres = np.zeros((len(views), 3)), np.zeros((len(views), 3))
    for row, pose in part.poses.items():
        own = rows == row
        pixels = features[row].keypoints_px[views[own] - start[row]]
        seen = homogeneous(part.camera.normalize(pixels.astype(np.float64))) @ pose.rotation.T
        rays[own] = seen / np.linalg.norm(seen, axis=1, keepdims=True)
        centres[own] = pose.translation
    return _Tracks(
        rows, centres, rays, np.concatenate([[0], np.cumsum([len(own) for own in kept])]).astype(np.intp)
    )


def _splits(tracks: _Tracks) -> tuple[Rows, Rows, Rows]:
    """Return for each point and step the views [lower, middle) before and [middle, upper) after it, two and more."""
    found: list[tuple[int, int, int]] = []
    for a, b in pairwise(tracks.first.tolist()):
        rows = tracks.rows[a:b]
        for k in range(2, b - a - 1):
            first = int(np.searchsorted(rows, rows[k - 1] - OPTIONS.window + 1))
            last = int(np.searchsorted(rows, rows[k] + OPTIONS.window))
            if k - first >= 2 and last - k >= 2:
                found.append((a + first, a + k, a + last))
    lower, middle, upper = np.array(found, np.intp).reshape(-1, 3).T
    return lower, middle, upper


def _points(tracks: _Tracks, lower: Rows, upper: Rows) -> tuple[Array, NDArray[np.bool_], Array]:
    """Return the points (n, 3) nearest to the rays of views [lower, upper), whether each is known, and the largest
    angle (n,), radians, between its first ray and the others."""
    across = np.eye(3) - tracks.rays[:, :, None] * tracks.rays[:, None, :]
    offset = np.einsum("nij,nj->ni", across, tracks.centres)
    sums = np.concatenate([np.zeros((1, 3, 3)), np.cumsum(across, axis=0)])
    offsets = np.concatenate([np.zeros((1, 3)), np.cumsum(offset, axis=0)])
    normal = sums[upper] - sums[lower] + 1e-12 * np.eye(3)
    points = np.linalg.solve(normal, (offsets[upper] - offsets[lower])[..., None])[..., 0]
    lengths = upper - lower
    split = np.repeat(np.arange(len(lower)), lengths)
    begin = np.cumsum(lengths) - lengths
    view = np.arange(lengths.sum()) - np.repeat(begin - lower, lengths)
    ahead = points[split] - tracks.centres[view]
    depth = (ahead * tracks.rays[view]).sum(axis=1)
    direction = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    error = np.linalg.norm(direction - tracks.rays[view], axis=1)
    angle = np.linalg.norm(direction - direction[np.repeat(begin, lengths)], axis=1)
    if not len(lower):
        return points, np.zeros(0, np.bool_), np.zeros(0)
    widest = np.maximum.reduceat(angle, begin)
    fits = np.maximum.reduceat(error, begin) <= tangent_of_px(OPTIONS.max_error_px)
    known = fits & (np.minimum.reduceat(depth, begin) > 0) & (widest >= np.radians(OPTIONS.min_angle_deg))
    return points, known, np.maximum(widest, 1e-9)
