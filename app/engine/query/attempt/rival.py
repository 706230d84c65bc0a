"""The other place that a picture may be of: what explains the matches that its best pose does not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from app.engine.query.attempt.pose import Matcher, PoseSearch
from app.engine.query.hypothesis import Hypothesis
from app.engine.query.localization import KeyframeVote, leading, same_place, votes_of
from app.engine.query.matches import Matches
from app.engine.query.second.look import SecondMatcher
from app.geometry.camera import Camera


@dataclass(frozen=True, slots=True)
class Contest:
    """The pose that most speaks for, the votes of the keyframes behind it with the `leading` ones, and the pose of
    another place for which not much less speaks, None where there is none."""

    best: Hypothesis
    votes: tuple[KeyframeVote, ...]
    leading: list[int]
    rival: Hypothesis | None

    def won_by(self, best: Hypothesis) -> Contest:
        """Return the contest with another pose of the same place as the best one."""
        votes = votes_of(best.matches, best.inliers)
        return Contest(best, votes, leading(votes), self.rival)


def against_rival(search: PoseSearch, matcher: Matcher, best: Hypothesis, camera: Camera) -> Contest:
    """Return a pose beside the best one of another place, which wins where more speaks for it."""
    votes = votes_of(best.matches, best.inliers)
    voted = leading(votes)
    rival = find_rival(search, matcher, best, voted, camera)
    if rival is None:
        return Contest(best, votes, voted, None)
    own, other = (_support(matcher, each, camera) for each in (best, rival))
    if other > own:
        best, rival, own, other = rival, best, other, own
        votes = votes_of(best.matches, best.inliers)
        voted = leading(votes)
    is_near = other > search.settings.rival_support_ratio * own
    return Contest(best, votes, voted, rival if is_near else None)


def find_rival(
    search: PoseSearch, matcher: Matcher, best: Hypothesis, voted: Sequence[int], camera: Camera
) -> Hypothesis | None:
    """Return the best other place that explains matches which the best pose doesn't, on equal terms.

    Places that look like the best keyframes, `voted`, are matched for it, whether retrieval found them or not.
    """
    settings, unexplained, twins = search.settings, ~best.estimate.inlier_mask, list[int]()
    if settings.look_alikes:
        twins = search.map.retrieval.look_alikes_of(voted, settings.look_alikes, matcher.query.allowed)
    rest = Matches.merge([best.matches.take(unexplained), matcher.match(twins)])
    needed = max(settings.min_rival_inliers, settings.rival_ratio * best.inlier_features)
    if search.limits.max_rival_share >= 1.0 or rest.feature_count < needed:
        return None
    (found,) = search.poses(rest, [camera], settings.rival_iterations)
    first = None if found is None else Hypothesis.of(found, rest)
    if first is None or first.inlier_features < needed or same_place(first.pose, best.pose):
        return None
    rival = search.best(matcher, rest, camera, first)
    return None if rival is None or same_place(rival.pose, best.pose) else rival


def _support(matcher: Matcher, found: Hypothesis, camera: Camera) -> int:
    """Return how much speaks for a pose: cells that agree more than disagree, or inliers where none are compared."""
    if isinstance(matcher, SecondMatcher):
        return matcher.agreement(found.pose, camera).balance
    return found.inlier_features
