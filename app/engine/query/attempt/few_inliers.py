"""Whether a picture looks as a pose says that only few features speak for."""

from __future__ import annotations

from dataclasses import dataclass

from app.engine.query.attempt.pose import Matcher, PoseSearch
from app.engine.query.second.agreement import Agreement, agreement_in_map
from app.engine.query.second.look import SecondMatcher
from app.engine.stage_timer import clock_s
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.limits import limit

MEASURED = (
    "roomfix evaluate-rooms, all splits of three rooms: none of 73 right answers with under 40 inliers is refused, "
    "and the only wrong answer is refused, with 12 inliers, where 5 of 8 cells agree."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class FewInliersOptions:
    """Which poses of a first look are compared with the whole picture, and when one is refused."""

    max_inliers: int = limit(
        30,
        "From as many inliers on a pose is not compared.",
        chosen="By hand: the network that compares takes as long as the rest of a query; such poses are right.",
    )
    min_agreeing_cells: int = limit(
        7, "With as many cells that look as the pose says it is not refused.", chosen=MEASURED
    )
    max_disagreeing_share: float = limit(
        0.35,
        "With fewer it is refused where a larger share does not, of the cells that do and do not.",
        chosen=MEASURED,
    )


OPTIONS = FewInliersOptions()


def looks_otherwise(search: PoseSearch, matcher: Matcher, world_from_camera: Pose, camera: Camera) -> bool:
    """Return whether the rest of a picture speaks against a pose of a first look that few features speak for.

    A dozen matches agree on some pose by chance, most of all in one corner of a picture. Only maps with second features
    tell; a second look compares all its poses itself.
    """
    opened = search.map
    if isinstance(matcher, SecondMatcher) or opened.second_look is None or not search.settings.second_look:
        return False
    query, started = matcher.query, clock_s()
    _, picture = opened.second_look.extractor.extract_dense(query.gray)
    query.spent_s["describe"] += clock_s() - started
    return speaks_against(agreement_in_map(opened, world_from_camera, camera, picture, query.allowed))


def speaks_against(found: Agreement) -> bool:
    """Return whether little of a picture looks as a pose says, and much does not."""
    is_seen = found.agreeing >= OPTIONS.min_agreeing_cells
    return not is_seen and found.disagreeing_share > OPTIONS.max_disagreeing_share
