"""What a frame turned out to be, for the tracker's state machine: one of these events."""

from __future__ import annotations

from dataclasses import dataclass

from app.engine.query.placed import Accuracy, Support
from app.engine.query.verification import Reason
from app.engine.tracking.fix import Fix
from app.engine.tracking.odometry.visual_odometry import OdometryStep
from app.engine.tracking.own_view import SeenAgain
from app.geometry.camera import Camera


@dataclass(frozen=True, slots=True)
class Followed:
    """Odometry followed the points of the frame before, and no fix corrects it."""

    step: OdometryStep
    camera: Camera


@dataclass(frozen=True, slots=True)
class Corrected:
    """A fix is near the place that odometry has for the frame, whose accuracy is given."""

    step: OdometryStep
    accuracy: Accuracy
    fix: Fix


@dataclass(frozen=True, slots=True)
class Returned:
    """The frame shows a view of the session's own past again, which is more accurate than odometry is by now; without
    a step odometry has lost the camera."""

    step: OdometryStep | None
    seen: SeenAgain
    camera: Camera


@dataclass(frozen=True, slots=True)
class Found:
    """A fix was found without odometry, and can be believed; `resumed` when the camera was lost before."""

    fix: Fix
    resumed: bool


@dataclass(frozen=True, slots=True)
class Doubted:
    """A fix was found where the camera can't have come by what is known: it waits for a second one that agrees."""

    fix: Fix
    camera: Camera | None


@dataclass(frozen=True, slots=True)
class Unseen:
    """The frame was searched for and not found."""

    reason: Reason
    support: Support
    camera: Camera | None


@dataclass(frozen=True, slots=True)
class Unsearched:
    """The frame was not searched for: the map may not be used again, or a search failed a moment ago."""

    camera: Camera | None


Event = Followed | Corrected | Returned | Found | Doubted | Unseen | Unsearched
