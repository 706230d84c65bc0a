"""A frame of a query that has several, and what it alone leads to."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.engine.query.localization import Localization
from app.engine.query.localizer import Localizer
from app.engine.query.matches import QueryMatcher
from app.engine.query.query import Query
from app.engine.query.upright import turned_known
from app.geometry.camera import Camera
from app.geometry.focal import ApproximateCamera
from app.geometry.se3 import Pose
from app.geometry.turns import camera_from_turned, turned_camera, upright_turns
from app.vision.images import Rgb

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class GivenFrame:
    """A picture (height, width, 3) as it was given, what is known of its camera, its pose in frame 0 (None where the
    motion is not known), and the direction of down in its camera axes (None where not known)."""

    rgb: Rgb
    camera: Camera | ApproximateCamera | None
    first_from_camera: Pose | None = None
    gravity: Vector | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class AskedFrame:
    """A frame after it was asked alone.

    Its picture may have been turned upright by `turns` quarter turns: `found`, `matcher` and `camera` are those of the
    turned picture, `given_from_turned` moves points from its camera's axes to those of the given picture, and
    `first_from_turned` to the axes of frame 0 as given (None where the motion is not known).
    """

    matcher: QueryMatcher
    found: Localization
    camera: Camera | None
    turns: int
    given_from_turned: Pose
    first_from_turned: Pose | None

    @property
    def world_from_given(self) -> Pose | None:
        """The pose of the given picture's camera, None where the frame is not located alone."""
        pose = self.found.world_from_camera
        return None if pose is None else pose @ self.given_from_turned.inverse()

    @property
    def world_from_first(self) -> Pose | None:
        """The pose of frame 0 by this frame alone and its motion, None where one of them is not known."""
        pose = self.found.world_from_camera
        if pose is None or self.first_from_turned is None:
            return None
        return pose @ self.first_from_turned.inverse()


def ask_alone(
    localizer: Localizer, given: GivenFrame, allowed: NDArray[np.int64] | None = None
) -> AskedFrame:
    """Localize one frame by itself, turned upright by its gravity; `allowed` restricts retrieval."""
    turns = None if given.gravity is None else upright_turns(given.gravity)
    quarter = turns or 0
    rgb = np.ascontiguousarray(np.rot90(given.rgb, quarter)) if quarter else given.rgb
    query = Query.of(rgb, turned_known(given.camera, quarter), allowed, upright=turns is not None)
    matcher = localizer.matcher_of(query)
    found = localizer.answer(query, matcher)
    turned = camera_from_turned(quarter)
    first = given.first_from_camera
    return AskedFrame(
        matcher=matcher,
        found=found,
        camera=query.known if isinstance(query.known, Camera) else None,
        turns=quarter,
        given_from_turned=turned,
        first_from_turned=None if first is None else first @ turned,
    )


def as_given(frame: AskedFrame, found: Localization, world_from_given: Pose | None) -> Localization:
    """Return an outcome about the turned picture as one about the given picture, with its pose."""
    return replace(
        found,
        world_from_camera=world_from_given,
        camera=None if found.camera is None else turned_camera(found.camera, -frame.turns),
        # Their pixels are those of the turned picture.
        inliers=found.inliers if frame.turns == 0 else None,
    )
