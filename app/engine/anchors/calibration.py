"""Self-calibration: the pose of a monitoring camera in the map, and the positions of its POIs by the map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.engine.anchors.anchor import AnchorSpec, Poi
from app.engine.anchors.map_depth import SeenPoints
from app.engine.anchors.monitor_pose import find_monitor
from app.engine.anchors.poi_triangulation import centroid, inside_region, region_in
from app.engine.floors.floor import Floor
from app.engine.maps.artifact import MapArtifact
from app.engine.maps.open_map import OpenMap
from app.errors import ConflictError
from app.geometry.camera import Camera
from app.geometry.plan import PlanTransform, plan_position
from app.geometry.se3 import Pose, rotation_from_quaternion
from app.geometry.triangulation import homogeneous
from app.limits import limit
from app.vision.images import Rgb


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorCalibrationOptions:
    """Which keyframes a camera is searched in, and how far its pose may be from what was entered for it."""

    keyframe_radius_m: float = limit(
        10.0,
        "Largest distance on the plan of a keyframe from the position that was entered for the camera.",
        chosen="By hand; no measurement is recorded.",
    )
    max_camera_error_m: float = limit(
        2.0,
        "Largest distance on the plan of the calibrated position from the entered one.",
        chosen="By hand: places that look alike are further apart.",
    )
    max_poi_error_m: float = limit(
        1.0,
        "Constant part of the largest error, for most POIs, of the entered position by the calibrated pose.",
        chosen="By hand; no measurement is recorded.",
    )
    max_poi_error_ratio: float = limit(
        0.1,
        "Part of it that grows with the POI's distance, divided by the distance.",
        chosen="By hand; no measurement is recorded.",
    )
    poi_radius_ratio: float = limit(
        0.5,
        "Largest distance of a map point from a region's middle that counts for the POI's distance, divided by the "
        "region's size.",
        chosen="By hand; no measurement is recorded.",
    )
    min_poi_points: int = limit(
        5,
        "Least number of these map points.",
        chosen="By hand; no measurement is recorded.",
    )


OPTIONS = AnchorCalibrationOptions()


@dataclass(frozen=True, slots=True)
class StoredCalibration:
    """A monitoring camera in the map: its pose, the standard deviations of position and attitude, and the points it
    sees, packed by `SeenPoints.pack`, None where they were not stored."""

    world_from_camera: Pose
    position_sigma_m: float
    orientation_sigma_deg: float
    points: str | None


def calibrate_in_map(
    opened: OpenMap, map_version: int, floor: Floor, spec: AnchorSpec, camera: Camera, rgb: Rgb
) -> dict[str, Any]:
    """Return a camera's calibration as the anchor stores it: pose in the world, position on the plan, POIs.

    Raises `ConflictError` when the map does not determine the pose to 5 cm and 0.5 degrees (one standard deviation),
    when the pose contradicts what was entered for the camera, or when the floor has no `plan_from_world`.
    """
    if floor.plan_from_world is None:
        raise ConflictError(
            f"Floor {floor.id!r} has no plan_from_world yet, so its map says nothing of the plan."
        )
    plan = PlanTransform(floor.plan_from_world)
    found = find_monitor(opened, camera, rgb, keyframes_near(opened.artifact, floor, plan, spec))
    if isinstance(found, str):
        raise ConflictError(
            f"The camera could not be calibrated: {found}. Scan what the camera sees, or check its position and "
            "intrinsics, then try again."
        )
    pose = found.world_from_camera
    _check_place(spec, camera, pose, plan)
    x, y, heading_deg = plan_position(plan, pose)
    pois = [_poi(poi, spec, camera, pose, plan, found.seen) for poi in spec.pois]
    return {
        "map_version": map_version,
        "pose": {
            "position": dict(zip("xyz", pose.translation.tolist(), strict=True)),
            "quaternion": dict(zip("xyzw", pose.quaternion.tolist(), strict=True)),
        },
        "plan": {"x": x, "y": y, "heading_deg": heading_deg},
        "height_m": float(plan.apply(pose.translation)[2]),
        "accuracy": {
            "position_m": found.position_sigma_m,
            "orientation_deg": found.orientation_sigma_deg,
        },
        "inliers": found.inliers,
        "points": found.seen.pack(camera),
        "pois": [poi for poi in pois if poi is not None],
    }


def calibration_of(values: dict[str, Any] | None) -> StoredCalibration | None:
    """Return a stored calibration, or None for a camera without one."""
    if values is None:
        return None
    position, quaternion = values["pose"]["position"], values["pose"]["quaternion"]
    return StoredCalibration(
        Pose(
            rotation_from_quaternion(*(quaternion[key] for key in "xyzw")),
            np.array([position[key] for key in "xyz"]),
        ),
        values["accuracy"]["position_m"],
        values["accuracy"]["orientation_deg"],
        values.get("points"),
    )


def keyframes_near(
    artifact: MapArtifact, floor: Floor, plan: PlanTransform, spec: AnchorSpec
) -> NDArray[np.int64]:
    """Return the keyframes (rows) of an anchor's floor near the position that was entered for it."""
    positions = artifact.arrays.positions
    heights = positions[:, 2]
    on_floor = (heights >= floor.z_min_m) & (heights < floor.z_max_m)
    distances_m = np.linalg.norm(plan.apply(positions)[:, :2] - [spec.x, spec.y], axis=1)
    return np.flatnonzero(on_floor & (distances_m < OPTIONS.keyframe_radius_m)).astype(np.int64)


def _check_place(spec: AnchorSpec, camera: Camera, world_from_camera: Pose, plan: PlanTransform) -> None:
    """Raise `ConflictError` when the camera or most POIs are far from their entered positions by a pose.

    This rejects places that look alike, and poses by matches in one corner of the image.
    """
    at = plan.apply(world_from_camera.translation)
    moved_m = float(np.linalg.norm(at[:2] - [spec.x, spec.y]))
    error_ratios = []
    for poi in spec.pois:
        ray = homogeneous(camera.normalize(centroid(region_in(poi, spec, camera))))[0]
        towards = plan.rotation @ world_from_camera.rotation @ (ray / np.linalg.norm(ray))
        error_m = np.linalg.norm((at + poi.distance_m * towards)[:2] - [poi.x, poi.y])
        tolerance_m = OPTIONS.max_poi_error_m + OPTIONS.max_poi_error_ratio * poi.distance_m
        error_ratios.append(error_m / tolerance_m)
    if moved_m > OPTIONS.max_camera_error_m or float(np.median(error_ratios)) > 1.0:
        raise ConflictError(
            f"By the map the camera hangs at ({at[0]:.2f}, {at[1]:.2f}) m on the plan, {moved_m:.1f} m from where it "
            "was entered, and its POIs don't fit there; correct position and pois, or scan what the camera sees."
        )


def _poi(
    poi: Poi, spec: AnchorSpec, camera: Camera, world_from_camera: Pose, plan: PlanTransform, seen: SeenPoints
) -> dict[str, Any] | None:
    """Return a POI's position by the map, or None when the map has too few points in the middle of its region."""
    corners = region_in(poi, spec, camera)
    middle = centroid(corners)
    size = float(np.ptp(corners, axis=0).max())
    near = np.linalg.norm(seen.pixels - middle, axis=1) < OPTIONS.poi_radius_ratio * size
    near &= inside_region(seen.pixels, corners)
    if np.count_nonzero(near) < OPTIONS.min_poi_points:
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
