"""Positioning by a venue's anchors: those that are live now, and who was of use."""

from __future__ import annotations

from collections.abc import Sequence

from app.engine.anchors.features import AnchorDescriber
from app.engine.anchors.locator import AnchorLocalization, locate_by_anchors
from app.engine.stage_timer import StageTimer
from app.geometry.camera import Camera
from app.services.anchor_library import AnchorLibrary
from app.services.resources import Resources
from app.storage.anchors import count_uses
from app.vision.images import Rgb


class AnchorLocator:
    """Answers queries by anchors. Safe to share between threads."""

    def __init__(self, resources: Resources, describer: AnchorDescriber) -> None:
        self._resources = resources
        self._describer = describer
        self._library = AnchorLibrary(resources)

    def locate(
        self,
        venue_id: str,
        floor_id: str | None,
        rgb: Rgb,
        camera: Camera,
        gravity: Sequence[float] | None,
    ) -> AnchorLocalization:
        """Return where an image was taken, by the anchors of a venue or of one floor (`locate_by_anchors`)."""
        timer = StageTimer()
        live = self._library.live(venue_id, floor_id)
        timer.lap("anchors")
        found = locate_by_anchors(live, self._describer, rgb, camera, gravity, timer)
        if found.plan_from_phone is not None:
            with self._resources.database.write() as connection:
                count_uses(connection, found.anchors)
        return found
