"""A second attempt at a frame that the first one did not place, with more keyframes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.open_map import OpenMap
from app.engine.query.attempt.attempt import attempt
from app.engine.query.attempt.pose import PoseSearch
from app.engine.query.attempt.votes import voted_keyframes
from app.engine.query.localization import Localization
from app.engine.query.matches import QueryMatcher
from app.engine.stage_timer import clock_s


def voted_by(matcher: QueryMatcher, opened: OpenMap, count: int) -> list[int]:
    """Return up to `count` keyframes that share single features with a query's picture, those with most first.

    Maps of binary features have none.
    """
    if opened.extractor.binary:
        return []
    started = clock_s()
    _, unit = matcher.features
    found = voted_keyframes(opened.artifact, unit, count, matcher.query.allowed)
    matcher.query.spent_s["retrieve"] += clock_s() - started
    return found


def second_attempt(
    search: PoseSearch, matcher: QueryMatcher, descriptor: NDArray[np.float32], voted: list[int]
) -> Localization:
    """Localize with keyframes further down the ranks, with the `voted` ones, and with those for the image turned by 90,
    180 and 270 degrees, since the global descriptor wants it upright and the phone may not say how it was held."""
    query, opened, settings = matcher.query, search.map, search.settings
    rows = opened.retrieval.similar(descriptor, settings.second_attempt, 0, query.allowed)
    for turns in () if query.upright else (1, 2, 3):
        turned = opened.descriptor.describe(np.ascontiguousarray(np.rot90(query.rgb, turns)))
        rows += opened.retrieval.similar(turned, settings.keyframes, 0, query.allowed)
    return attempt(search, matcher, matcher.match_all([*voted, *rows]))
