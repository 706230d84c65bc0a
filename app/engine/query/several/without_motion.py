"""One answer from frames of which it is known only that they were taken near each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from app.engine.query.attempt.attempt import attempt
from app.engine.query.localization import Localization
from app.engine.query.localizer import Localizer
from app.engine.query.matches import Matches
from app.engine.query.placed import Support
from app.engine.query.several.frame import AskedFrame, as_given
from app.engine.query.several.options import OPTIONS
from app.vision.features import LocalFeatureExtractor
from app.vision.matching import match_unit_vectors, unit_distances


def locate_without_motion(localizer: Localizer, frames: Sequence[AskedFrame]) -> Localization:
    """Return where frame 0 is, by its own pose where other frames don't contradict it.

    Frames that are located alone must be near each other, or most of them are against the rest, which is left out.
    Where frame 0 is not among them it is asked again: what it shares with them has known places in the world.
    """
    first = frames[0]
    alone = as_given(first, first.found, first.world_from_given)
    located = [frame for frame in frames if frame.found.world_from_camera is not None]
    together = _most_together(located)
    if 2 * len(together) <= len(located):
        return alone.refused("ambiguous") if located else alone
    supports = tuple(
        frame.found.evidence.support if frame in together else Support(0, frame.found.evidence.matches)
        for frame in frames
    )
    if first in together:
        return replace(alone, frames=supports)
    again = _asked_again(localizer, first, together)
    pose = again.world_from_camera
    if pose is None:
        return alone if alone.world_from_camera is None else alone.refused("ambiguous")
    if not all(_are_near(pose.translation, _centre(frame)) for frame in together):
        return alone.refused("ambiguous")
    surest = max(frame.found.confidence for frame in together)
    again = replace(again, confidence=min(again.confidence, surest))
    supports = (again.evidence.support, *supports[1:])
    return replace(as_given(first, again, pose @ first.given_from_turned.inverse()), frames=supports)


def _most_together(located: Sequence[AskedFrame]) -> list[AskedFrame]:
    """Return the frames near one of them that are most."""
    groups = [[other for other in located if _are_near(_centre(frame), _centre(other))] for frame in located]
    return max(groups, key=len, default=[])


def _centre(frame: AskedFrame) -> NDArray[np.float64]:
    pose = frame.found.world_from_camera
    assert pose is not None  # noqa: S101 - asked of located frames alone
    return pose.translation


def _are_near(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    return float(np.linalg.norm(a - b)) <= OPTIONS.max_spread_m


def _asked_again(localizer: Localizer, first: AskedFrame, located: Sequence[AskedFrame]) -> Localization:
    """Localize frame 0 by its matches with the map and those that located frames carry over to it."""
    matcher = first.matcher
    carried = [_carried(first, frame, localizer.map.extractor) for frame in located]
    return attempt(localizer.search, matcher, Matches.merge([matcher.match_all(()), *carried]))


def _carried(first: AskedFrame, located: AskedFrame, extractor: LocalFeatureExtractor) -> Matches:
    """Return matches of frame 0 with what a located frame shows: its inliers, with their places in the world.

    The distance of a match is the larger one of the two that it is made of.
    """
    inliers, (pixels, theirs) = located.found.inliers, located.matcher.features
    if inliers is None or not _are_rows_of(inliers, pixels):
        return Matches.none()
    nearest = inliers.take(_nearest_of_each(inliers))
    own_px, own = first.matcher.features
    rows, matched, _ = match_unit_vectors(own, theirs[nearest.query_rows], extractor.ratio, extractor.binary)
    carried = nearest.take(matched)
    distances = np.maximum(carried.distances, unit_distances(own[rows], theirs[carried.query_rows]))
    return replace(carried, points_px=own_px[rows], query_rows=rows, distances=distances)


def _are_rows_of(inliers: Matches, pixels: NDArray[np.float64]) -> bool:
    """Whether the matches are of these features (n, 2): a later attempt may have been made with others."""
    rows = inliers.query_rows
    return (
        bool(len(rows)) and int(rows.max()) < len(pixels) and np.array_equal(pixels[rows], inliers.points_px)
    )


def _nearest_of_each(inliers: Matches) -> NDArray[np.intp]:
    """Return the row (m,) of the match of least distance of each feature."""
    order = np.argsort(inliers.distances, kind="stable")
    _, firsts = np.unique(inliers.query_rows[order], return_index=True)
    return np.asarray(order[firsts])
