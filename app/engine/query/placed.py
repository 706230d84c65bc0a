"""The values that every answer is made of: where a camera is, how accurately, and on what evidence."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from app.engine.maps.artifact import MapMetadata
from app.geometry.se3 import Pose

WORLD = "world"


@dataclass(frozen=True, slots=True)
class Accuracy:
    """One standard deviation of a pose: of the position's error in metres, of the orientation's in degrees."""

    position_m: float
    orientation_deg: float

    def with_more(self, other: Accuracy) -> Accuracy:
        """Return the accuracy with an independent error added."""
        return Accuracy(
            math.hypot(self.position_m, other.position_m),
            math.hypot(self.orientation_deg, other.orientation_deg),
        )

    def beyond(self, part: Accuracy) -> Accuracy:
        """Return the error that makes this of an independent `part` of it."""
        return Accuracy(
            math.sqrt(max(self.position_m**2 - part.position_m**2, 0.0)),
            math.sqrt(max(self.orientation_deg**2 - part.orientation_deg**2, 0.0)),
        )

    def with_map_error(self, metadata: MapMetadata) -> Accuracy:
        """Return the accuracy with the map's own error, which all points share and no covariance of them shows."""
        return Accuracy(
            float(np.hypot(self.position_m, metadata.position_sigma_m)),
            float(np.hypot(self.orientation_deg, metadata.orientation_sigma_deg)),
        )


def with_camera(
    whole: Accuracy, systematic: Accuracy, among: Accuracy | None, metadata: MapMetadata
) -> tuple[Accuracy, Accuracy | None]:
    """Return the accuracy of a pose with the map's error and with what is not known of its camera, and that among
    pictures of this camera where it is less (`among`)."""
    alike = None if among is None else whole.with_more(among).with_map_error(metadata)
    return whole.with_more(systematic).with_map_error(metadata), alike


@dataclass(frozen=True, slots=True)
class Support:
    """How many features of a picture agree with a pose, and how many were matched; each counts once."""

    inliers: int = 0
    matches: int = 0


@dataclass(frozen=True, slots=True)
class PlacedPose:
    """A camera's pose and the frame that it is in: `world`, or `plan:FLOOR` for a floor without `plan_from_world`.

    Both frames are metric with z up.
    """

    frame_from_camera: Pose
    frame_id: str = WORLD

    @property
    def world_from_camera(self) -> Pose | None:
        """The pose in the world; None for a pose that is known on a plan alone."""
        return self.frame_from_camera if self.frame_id == WORLD else None


def plan_frame(floor_id: str) -> str:
    """Return the frame of poses on a floor whose plan has no place in the world."""
    return f"plan:{floor_id}"
