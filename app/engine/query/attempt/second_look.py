"""A second look at a picture that was refused: its matches with the map's second features."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from app.engine.maps.open_map import SecondLook
from app.engine.query.attempt.attempt import attempt, nothing
from app.engine.query.attempt.pose import PoseSearch
from app.engine.query.localization import Localization
from app.engine.query.matches import Matches, QueryMatcher
from app.engine.query.second.look import OPTIONS, SecondMatcher
from app.engine.query.verification import Limits
from app.geometry.camera import Camera


def second_look(
    search: PoseSearch, first: QueryMatcher, look: SecondLook, similar: Sequence[int]
) -> Localization:
    """Localize the picture of a matcher that found too little, by limits of their own.

    `similar` are the keyframes that look most like it. Where the first pose already shows that the picture will be
    refused, no further keyframes are matched: the network takes most of the time.
    """
    matcher = SecondMatcher(first.query, search.map, first, look)
    matches = matcher.match(similar[: OPTIONS.keyframes])
    settings = replace(
        search.settings,
        covisible=OPTIONS.covisible,
        look_alikes=OPTIONS.look_alikes,
        rival_support_ratio=OPTIONS.max_rival_balance_ratio,
    )
    wider = PoseSearch(search.map, settings, _limits(search.limits))
    if matches.feature_count < OPTIONS.min_matches or is_hopeless(wider, matcher, matches):
        return nothing(first.query, matches, None)
    return without_vague_directions(attempt(wider, matcher, matches))


def without_vague_directions(found: Localization) -> Localization:
    """Return an outcome, refused where the stated camera leaves the direction of the pose open.

    Few inliers in one part of the picture can fix the place while the camera may be turned about it.
    """
    accuracy = found.accuracy
    if found.world_from_camera is None or accuracy is None:
        return found
    is_vague = accuracy.orientation_deg > OPTIONS.max_orientation_sigma_deg
    return found.refused("too_few_inliers") if is_vague else found


def _limits(own: Limits) -> Limits:
    return replace(
        own,
        min_inliers=OPTIONS.min_inliers,
        min_coverage=OPTIONS.min_coverage,
        min_unrepeated_share=OPTIONS.min_unrepeated_share,
        min_unrepeated_of_twin=0,
        max_contradicted_share_of_twin=1.0,
        min_agreeing_cells=OPTIONS.min_agreeing_cells,
        min_clear_cells=OPTIONS.min_clear_cells,
        max_disagreeing_share=OPTIONS.max_disagreeing_share,
    )


def is_hopeless(search: PoseSearch, matcher: SecondMatcher, matches: Matches) -> bool:
    """Return whether the matches with the most similar keyframes agree on no pose that may be trusted in the end.

    Without a camera nothing is known before the search for one.
    """
    known = matcher.query.known
    if not isinstance(known, Camera):
        return False
    found = search.estimate(matches, known)
    if found is None or found.inlier_features < OPTIONS.min_first_inliers:
        return True
    least = OPTIONS.min_first_unrepeated_share * found.inlier_features
    return matcher.unrepeated_count(found.inliers) < least
