"""Pictures located with and without the limits of places that look alike, and with a second look."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from app.engine.progress import Progress
from app.engine.query.localizer import Localizer
from app.vision.images import decode_image
from bench.evaluation.outcome import outcome_of
from bench.evaluation.pose_errors import QueryOutcome
from bench.recordings.queries import DemoQuery

WITHOUT_LIMITS = "one look, without the limits of look-alike places"
ONE_LOOK = "one look"
TWO_LOOKS = "with the second look"
LOOKS = (WITHOUT_LIMITS, ONE_LOOK, TWO_LOOKS)


@dataclass(frozen=True, slots=True)
class Asked:
    """The outcomes of pictures by the name of the look; `is_absent` when no map holds their places."""

    name: str
    is_absent: bool
    outcomes: Mapping[str, Sequence[QueryOutcome]]


def compare_looks(
    name: str, localizer: Localizer, queries: Sequence[DemoQuery], progress: Progress, is_absent: bool
) -> Asked:
    """Locate pictures with each look; of a place that is `is_absent` every answer is wrong.

    What is refused without the limits is refused with them too, and what one look locates gets no second one: the
    later looks are asked for the others alone.
    """
    lax, once, twice = _localizers(localizer)
    outcomes: dict[str, list[QueryOutcome]] = {look: [] for look in LOOKS}
    for done, query in enumerate(queries):
        progress.report(name, done, len(queries))
        first = _outcome(lax, query, is_absent)
        second = _outcome(once, query, is_absent) if first.located else first
        third = second if second.located else _outcome(twice, query, is_absent)
        for look, outcome in zip(LOOKS, (first, second, third), strict=True):
            outcomes[look].append(outcome)
    return Asked(name, is_absent, outcomes)


def _localizers(localizer: Localizer) -> tuple[Localizer, Localizer, Localizer]:
    """Return the localizers of `LOOKS`."""
    opened, limits = localizer.map, localizer.limits
    once = replace(localizer.settings, second_look=False, limits=limits)
    lax = replace(limits, min_unrepeated_of_twin=0, max_contradicted_share_of_twin=1.0)
    return (
        Localizer(opened, replace(once, limits=lax)),
        Localizer(opened, once),
        Localizer(opened, replace(once, second_look=True)),
    )


def _outcome(localizer: Localizer, query: DemoQuery, is_absent: bool) -> QueryOutcome:
    found = localizer.localize(decode_image(query.path.read_bytes()), query.camera)
    truth = None if is_absent else query.world_from_camera
    return outcome_of(query.name, found, truth, sum(found.timings_ms.values()))
