"""Positioning by a venue's anchors: those that are live now, and who was of use."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

from app.engine.anchors.anchor import ANYWHERE, AnchorSearch
from app.engine.anchors.features import AnchorDescriber
from app.engine.anchors.locator import AnchorLocalization, locate_by_anchors
from app.engine.stage_timer import StageTimer
from app.errors import DatabaseBusyError
from app.geometry.camera import Camera
from app.limits import limit
from app.services.anchor_library import AnchorLibrary
from app.services.floor_features import FeatureLibrary
from app.services.resources import Resources
from app.storage.anchors import count_uses
from app.vision.images import Rgb

log = logging.getLogger("roomfix.anchors")


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorUseOptions:
    """How long an answer waits to count the anchors that it used."""

    count_wait_s: float = limit(
        0.2,
        "Time that a query waits for the lock of the database to count its anchors; they are not counted after that.",
        chosen="By hand: longer than a write of our own, and no delay that a walker notices.",
    )


OPTIONS = AnchorUseOptions()


class AnchorLocator:
    """Answers queries by anchors. Safe to share between threads."""

    def __init__(self, resources: Resources, describer: AnchorDescriber, features: FeatureLibrary) -> None:
        self._resources = resources
        self._describer = describer
        self._library = AnchorLibrary(resources, features)

    def locate(
        self,
        venue_id: str,
        floor_id: str | None,
        rgb: Rgb,
        camera: Camera,
        gravity: Sequence[float] | None,
        search: AnchorSearch = ANYWHERE,
    ) -> AnchorLocalization:
        """Return where an image was taken, by the anchors of a venue, of one floor, or around the place of a
        `search` (`locate_by_anchors`)."""
        timer, around = StageTimer(), search.around
        live = self._library.live(venue_id, floor_id if around is None else around.floor_id)
        if around is not None:
            live = [
                one for one in live if around.has_anchor(one.anchor.spec, has_walls=one.walls is not None)
            ]
        timer.lap("anchors")
        found = locate_by_anchors(live, self._describer, rgb, camera, gravity, timer, search)
        if found.plan_from_phone is not None:
            self._count_uses(found.anchors)
        return found

    def _count_uses(self, anchor_ids: Sequence[str]) -> None:
        """Count that anchors located a phone, unless another program holds the database: the answer doesn't wait."""
        try:
            with self._resources.database.write(OPTIONS.count_wait_s) as connection:
                count_uses(connection, anchor_ids)
        except DatabaseBusyError:
            log.warning(
                "the uses of anchors %s were not counted: the database is locked", ", ".join(anchor_ids)
            )
