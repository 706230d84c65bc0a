"""The other place that a picture may be of: what explains the matches that its best pose does not."""

from __future__ import annotations

from app.engine.query.attempt.pose import Matcher, PoseSearch
from app.engine.query.hypothesis import Hypothesis
from app.engine.query.localization import leading, same_place, votes_of
from app.engine.query.matches import Matches
from app.engine.query.second.look import SecondMatcher
from app.geometry.camera import Camera


def against_rival(
    search: PoseSearch, matcher: Matcher, best: Hypothesis, camera: Camera
) -> tuple[Hypothesis, Hypothesis | None]:
    """Return the pose that most speaks for, and the one of another place where not much less speaks for that."""
    rival = find_rival(search, matcher, best, camera)
    if rival is None:
        return best, None
    own, other = (_support(matcher, each, camera) for each in (best, rival))
    if other > own:
        best, rival, own, other = rival, best, other, own
    return best, rival if other > search.settings.rival_support_ratio * own else None


def find_rival(search: PoseSearch, matcher: Matcher, best: Hypothesis, camera: Camera) -> Hypothesis | None:
    """Return the best other place that explains matches which the best pose doesn't, on equal terms.

    Places that look like the best keyframes are matched for it, whether retrieval found them or not.
    """
    settings, unexplained, twins = search.settings, ~best.estimate.inlier_mask, list[int]()
    if settings.look_alikes:
        voted = leading(votes_of(best.matches, best.inliers))
        twins = search.map.retrieval.look_alikes_of(voted, settings.look_alikes, matcher.query.allowed)
    rest = Matches.merge([best.matches.take(unexplained), matcher.match(twins)])
    needed = max(settings.min_rival_inliers, settings.rival_ratio * best.inlier_features)
    if search.limits.max_rival_share >= 1.0 or len(rest) < needed:
        return None
    first = search.estimate(rest, camera, max_iterations=settings.rival_iterations)
    if first is None or same_place(first.pose, best.pose) or first.inlier_features < needed:
        return None
    rival = search.best(matcher, rest, camera, first)
    return None if rival is None or same_place(rival.pose, best.pose) else rival


def _support(matcher: Matcher, found: Hypothesis, camera: Camera) -> int:
    """Return how much speaks for a pose: cells that agree more than disagree, or inliers where none are compared."""
    if isinstance(matcher, SecondMatcher):
        return matcher.agreement(found.pose, camera).balance
    return found.inlier_features
