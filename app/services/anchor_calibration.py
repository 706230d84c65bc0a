"""Self-calibration: where the map says that a monitoring camera and its POIs are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from app.errors import ConflictError
from app.geometry.camera import Camera
from app.geometry.plan import PlanTransform, plan_position
from app.geometry.se3 import Pose, rotation_from_quaternion
from app.geometry.triangulation import homogeneous
from app.services.anchor_sights import centroid, inside_region, region_in
from app.services.localization import Localization
from app.services.localizer import Localizer
from app.services.map_depth import SeenPoints, points_seen
from app.storage.anchors import AnchorSpec, Poi
from app.storage.db import now
from app.storage.floors import Floor
from app.vision.images import Rgb

# Map points nearer to a POI's middle than this share of its region's size tell its distance.
POI_SHARE, MIN_POI_POINTS = 0.5, 5


@dataclass(frozen=True, slots=True)
class Calibration:
    """A monitoring camera in the map: its pose and one sigma of it, in metres and degrees."""

    world_from_camera: Pose
    position_sigma_m: float
    orientation_sigma_deg: float


def calibrate_in_map(
    localizer: Localizer, map_version: int, floor: Floor, spec: AnchorSpec, camera: Camera, rgb: Rgb
) -> dict[str, Any]:
    """Return a camera's calibration as the anchor stores it: pose in the world, place on the plan, POIs.

    Raises `ConflictError` when the frame can't be located in the map, or the floor's plan has no place in the world.
    """
    if floor.plan_from_world is None:
        raise ConflictError(
            f"Floor {floor.id!r} has no plan_from_world yet, so its map says nothing of the plan."
        )
    found = localizer.localize(rgb, camera)
    pose = found.world_from_camera
    if pose is None:
        raise ConflictError(
            f"The frame could not be located in the map ({found.reason}); scan what the camera sees, then try again."
        )
    plan = PlanTransform(floor.plan_from_world)
    x, y, heading_deg = plan_position(plan, pose)
    seen = points_seen(localizer.artifact, camera, pose)
    pois = [_poi(poi, spec, camera, pose, plan, seen) for poi in spec.pois]
    return {
        "map_version": map_version,
        "calibrated_at": now().isoformat(),
        "pose": {
            "position": dict(zip("xyz", pose.translation.tolist(), strict=True)),
            "quaternion": dict(zip("xyzw", pose.quaternion.tolist(), strict=True)),
        },
        "plan": {"x": x, "y": y, "heading_deg": heading_deg},
        "height_m": float(plan.apply(pose.translation)[2]),
        "accuracy": _accuracy(found),
        "inliers": found.evidence.inliers,
        "pois": [poi for poi in pois if poi is not None],
    }


def calibration_of(values: dict[str, Any] | None) -> Calibration | None:
    """Return a stored calibration, or None for a camera without one."""
    if values is None:
        return None
    position, quaternion = values["pose"]["position"], values["pose"]["quaternion"]
    return Calibration(
        Pose(
            rotation_from_quaternion(*(quaternion[key] for key in "xyzw")),
            np.array([position[key] for key in "xyz"]),
        ),
        values["accuracy"]["position_m"],
        values["accuracy"]["orientation_deg"],
    )


def _accuracy(found: Localization) -> dict[str, float]:
    assert found.position_m is not None  # noqa: S101 - a located frame has both
    assert found.orientation_deg is not None  # noqa: S101
    return {"position_m": found.position_m, "orientation_deg": found.orientation_deg}


def _poi(
    poi: Poi, spec: AnchorSpec, camera: Camera, world_from_camera: Pose, plan: PlanTransform, seen: SeenPoints
) -> dict[str, Any] | None:
    """Return a POI's place by the map, or None when the map has too few points in the middle of its region."""
    corners = region_in(poi, spec, camera)
    middle = centroid(corners)
    size = float(np.ptp(corners, axis=0).max())
    near = inside_region(seen.pixels, corners) & (
        np.linalg.norm(seen.pixels - middle, axis=1) < POI_SHARE * size
    )
    if np.count_nonzero(near) < MIN_POI_POINTS:
        return None
    length_m = float(np.median(seen.lengths_m[near]))
    ray = homogeneous(camera.normalize(middle))[0]
    point = world_from_camera.apply(length_m * ray / np.linalg.norm(ray))
    x, y, height_m = plan.apply(point)
    return {
        "id": poi.id,
        "position": {"x": float(x), "y": float(y)},
        "height_m": float(height_m),
        "distance_m": length_m,
    }
