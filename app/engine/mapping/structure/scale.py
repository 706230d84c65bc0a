"""Metres per unit of a reconstruction: by a known distance, a marker, the camera's height, the plan, or the sensor."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.structure.chosen import ChosenPictures, frame_time_s
from app.engine.mapping.structure.depth.measured import depth_ratios
from app.engine.mapping.structure.floor.levels import Floor, find_floor
from app.engine.mapping.structure.markers import marker_sides
from app.engine.mapping.structure.reconstruction import Reconstruction
from app.engine.mapping.structure.scale_options import (
    KnownDistance,
    KnownHeight,
    KnownMarker,
    KnownPlaces,
    PlanPlace,
    Point,
    Scale,
)
from app.engine.mapping.structure.tracks import point_of_pixel
from app.engine.mapping.structure.up import DownDirection
from app.engine.progress import Progress
from app.errors import DegenerateGeometryError, InvalidScanError
from app.geometry.alignment import align_2d, world_from_scan_by_gravity
from app.geometry.se3 import Pose
from app.limits import limit
from app.vision.images import Gray

Array = NDArray[np.float64]
GrayOf = Callable[[int], Gray]


@dataclass(frozen=True, slots=True, kw_only=True)
class ScaleOptions:
    """When what is known determines a scale."""

    own_depth: float = limit(
        2.0,
        "Median depth of the features, in the map's own unit, where no scale is known.",
        chosen="By hand: rooms have about 2 m, so that limits in metres mean roughly the same.",
    )
    max_marker_spread: float = limit(
        0.1,
        "Largest relative deviation of a marker's side from the median of all sides.",
        chosen="By hand: markers of different sizes, or one that was bent.",
    )
    max_plan_error_ratio: float = limit(
        0.2,
        "Largest residual of plan places, relative to their spread.",
        chosen="By hand: a place that was exchanged or a mirrored plan is off by far more.",
    )
    max_camera_height_m: float = limit(
        20.0,
        "Height of the camera above the floor from which on a scale is refused.",
        chosen="By hand: from a gallery people film 10 m above a hall; centimetres or inches stated as metres give 50 "
        "m and more.",
    )
    min_camera_height_m: float = limit(
        0.1,
        "Height of the camera above the floor below which a scale is refused.",
        chosen="By hand: nobody films so; millimetres where metres were meant give less.",
    )
    low_camera_height_m: float = limit(
        0.7,
        "Height of the camera above the floor below which a warning is given.",
        chosen="By hand: a child's hand.",
    )
    high_camera_height_m: float = limit(
        2.3,
        "Height of the camera above the floor from which on a warning is given.",
        chosen="By hand: a tall person's raised hand; feet stated as metres give 5 m.",
    )
    max_distance_m: float = limit(
        100.0,
        "Median distance of the features from which on a scale is refused where no floor is seen.",
        chosen="By hand: halls have 20 m; centimetres stated as metres make 200 m of a room.",
    )
    min_distance_m: float = limit(
        0.05,
        "Median distance of the features below which a scale is refused where no floor is seen.",
        chosen="By hand: nobody films a room from so near; a distance measured on the drawing gives it.",
    )
    far_distance_m: float = limit(
        30.0,
        "Median distance of the features from which on a warning is given where no floor is seen.",
        chosen="By hand: inches stated as metres make 80 m of a room.",
    )
    near_distance_m: float = limit(
        0.3,
        "Median distance of the features below which a warning is given where no floor is seen.",
        chosen="By hand: a desk has 0.7 m.",
    )
    min_depths: int = limit(100, "Features with depth that a scale needs.", chosen="By hand.")
    max_depth_deviation: float = limit(
        0.1,
        "Median relative deviation of measured depths from reconstructed ones above which a map is refused.",
        chosen="By hand: a sensor is within 0.01; a path whose scale drifts was off by 0.16.",
    )


OPTIONS = ScaleOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundScale:
    """Metres per unit, what it rests on, its figures, and where the options say so `world_from_scan` (in metres)."""

    metres_per_unit: float
    source: str
    figures: dict[str, Any] = field(default_factory=dict)
    plan_from_scan: Pose | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return it for the report."""
        return {"source": self.source, **self.figures}


def find_scale(
    scale: Scale | None,
    part: Reconstruction,
    chosen: ChosenPictures,
    down: DownDirection | None,
    gray: GrayOf,
    executor: Executor,
    progress: Progress,
) -> FoundScale | None:
    """Return the scale by what the options state, else by the depth images; None where there is neither.

    Raises `InvalidScanError` where what is stated can't be found in the pictures.
    """
    progress.report("find_scale", 0, 1)
    if isinstance(scale, KnownDistance):
        return _by_distance(scale, part, chosen, gray)
    if isinstance(scale, KnownMarker):
        return _by_marker(scale, part, gray, executor, progress)
    if isinstance(scale, KnownHeight):
        return _by_height(scale, part, _needed(down, "camera_height_m"))
    if isinstance(scale, KnownPlaces):
        return _by_places(scale, part, chosen, _needed(down, "correspondences"), gray)
    return _by_depth(part, chosen) if chosen.scan.has_depth else None


def doubts_of(scale: FoundScale | None, floor: Floor | None, depth: float) -> list[str]:
    """Return a sentence where the camera was held unusually high or low above the floor by this scale, else nothing.

    Without a floor `depth`, the median one of the features in the path's unit, says whether a scale is usual. Raises
    `InvalidScanError` where nobody holds a camera so, or films a building from so far.
    """
    if scale is None or scale.source == "camera_height":
        return []
    if floor is None:
        return _doubts_of_distance(scale, depth * scale.metres_per_unit)
    height_m = floor.height * scale.metres_per_unit
    check = "depth_scale" if scale.source == "depth" else "the numbers of scale, which are metres"
    sentence = f"By this scale the camera was held {height_m:.3g} m above the floor: check {check}."
    if not OPTIONS.min_camera_height_m <= height_m <= OPTIONS.max_camera_height_m:
        raise InvalidScanError(sentence)
    is_usual = OPTIONS.low_camera_height_m <= height_m <= OPTIONS.high_camera_height_m
    return [] if is_usual else [sentence]


def _doubts_of_distance(scale: FoundScale, distance_m: float) -> list[str]:
    if scale.source == "depth" or OPTIONS.near_distance_m <= distance_m < OPTIONS.far_distance_m:
        return []
    than = "nearer" if distance_m < OPTIONS.near_distance_m else "farther"
    sentence = (
        f"By this scale half of what the pictures show is {than} than {distance_m:.3g} m: check the numbers of scale, "
        "which are metres."
    )
    if not OPTIONS.min_distance_m <= distance_m < OPTIONS.max_distance_m:
        raise InvalidScanError(sentence)
    return [sentence]


def _by_distance(
    scale: KnownDistance, part: Reconstruction, chosen: ChosenPictures, gray: GrayOf
) -> FoundScale:
    row = _row_of(scale.frame, part, chosen)
    pixels = [_pixel(pixel, chosen) for pixel in scale.pixels]
    first, second = (point_of_pixel(part, row, pixel, gray) for pixel in pixels)
    return FoundScale(
        metres_per_unit=scale.distance_m / float(np.linalg.norm(second - first)),
        source="distance",
        figures={"frame": chosen.scan.frames[row].name},
    )


def _by_marker(
    scale: KnownMarker, part: Reconstruction, gray: GrayOf, executor: Executor, progress: Progress
) -> FoundScale:
    found = marker_sides(part, gray, executor, progress)
    if not found.seen:
        raise InvalidScanError(
            "No marker was seen in the pictures: print one with `roomfix marker`, lay it flat, and film it from near "
            "and from several sides."
        )
    if not len(found.sides):
        raise InvalidScanError(
            f"A marker was seen in {found.seen} pictures, too few from different places to measure it: film it from "
            "near while walking past it."
        )
    side = float(np.median(found.sides))
    spread = float(np.abs(found.sides / side - 1).max())
    if spread > OPTIONS.max_marker_spread:
        raise InvalidScanError(
            f"The sides of the markers differ by {spread:.0%}: all markers must be flat and of the same size."
        )
    return FoundScale(
        metres_per_unit=scale.side_m / side,
        source="marker",
        figures={"pictures": found.seen, "sides": len(found.sides), "spread": round(spread, 4)},
    )


def _by_height(scale: KnownHeight, part: Reconstruction, down: DownDirection) -> FoundScale:
    floor = find_floor(part, down.down)
    if floor is None:
        raise InvalidScanError(
            "The floor can't be found in the pictures, so the camera's height gives no scale: film the floor too, or "
            "give another scale."
        )
    camera = float(np.median([pose.translation @ floor.up for pose in part.poses.values()]))
    return FoundScale(
        metres_per_unit=scale.height_m / (camera - floor.level),
        source="camera_height",
        figures={"floor_points": len(floor.points)},
    )


def _by_places(
    scale: KnownPlaces, part: Reconstruction, chosen: ChosenPictures, down: DownDirection, gray: GrayOf
) -> FoundScale:
    upright = world_from_scan_by_gravity(down.down)
    source = np.array(
        [upright.apply(_place(place, part, chosen, gray)[None])[0, :2] for place in scale.places]
    )
    target = np.array([place.plan for place in scale.places])
    try:
        linear, translation = align_2d(source, target)
    except DegenerateGeometryError as error:
        raise InvalidScanError(f"scale.correspondences: {error}") from None
    metres = float(np.sqrt(np.linalg.det(linear)))
    errors = np.linalg.norm(source @ linear.T + translation - target, axis=1)
    spread = float(np.linalg.norm(target - target.mean(axis=0), axis=1).mean())
    if errors.max() > OPTIONS.max_plan_error_ratio * spread:
        worst = scale.places[int(errors.argmax())]
        raise InvalidScanError(
            f"The places of scale.correspondences don't fit the walk: that of frame {worst.frame} is off by "
            f"{errors.max():.2f} m. Check the coordinates: metres, x right and y up on the drawing."
        )
    turn = np.eye(3)
    turn[:2, :2] = linear / metres
    plan_from_scan = Pose(turn, np.array([*translation, 0.0])) @ upright
    return FoundScale(
        metres_per_unit=metres,
        source="correspondences",
        figures={"places": len(errors), "rms_m": round(float(np.sqrt((errors**2).mean())), 3)},
        plan_from_scan=plan_from_scan,
    )


def _place(place: PlanPlace, part: Reconstruction, chosen: ChosenPictures, gray: GrayOf) -> Array:
    row = _row_of(place.frame, part, chosen)
    if place.pixel is None:
        return part.poses[row].translation
    return point_of_pixel(part, row, _pixel(place.pixel, chosen), gray)


def _by_depth(part: Reconstruction, chosen: ChosenPictures) -> FoundScale:
    found = depth_ratios(part, chosen.depth_of)
    if len(found.ratios) < OPTIONS.min_depths:
        raise InvalidScanError(
            f"Only {len(found.ratios)} features of the pictures have depth: check depth_scale and that depth fits the "
            "colour images."
        )
    if found.deviation > OPTIONS.max_depth_deviation:
        raise InvalidScanError(
            f"The depth images contradict the pictures: the depths of features differ by {found.deviation:.0%} from "
            "where the pictures show them. Check that each depth image fits its colour image, in time and in place."
        )
    return FoundScale(
        metres_per_unit=found.metres_per_unit,
        source="depth",
        figures={"features": len(found.ratios), "median_deviation": round(found.deviation, 4)},
    )


def _needed(down: DownDirection | None, option: str) -> DownDirection:
    if down is None:
        raise InvalidScanError(
            f"scale.{option} needs to know which way is up, and neither vertical edges nor the camera's own axes "
            "show it: give another scale."
        )
    return down


def _row_of(frame: str, part: Reconstruction, chosen: ChosenPictures) -> int:
    """Return the row of the picture that a name, or the seconds of a video, stand for."""
    frames, time_s = chosen.scan.frames, frame_time_s(frame)
    by_name = [
        row for row, own in enumerate(frames) if own.name == frame or own.name.rpartition("/")[2] == frame
    ]
    if not by_name and time_s is not None and chosen.is_sequence:
        by_name = [int(np.argmin([abs(own.timestamp_s - time_s) for own in frames]))]
    if not by_name:
        raise InvalidScanError(f"scale: there is no frame {frame!r} among the pictures that are used.")
    if by_name[0] not in part.poses:
        raise InvalidScanError(
            f"scale: the frame {frame!r} is not connected with the largest part of the pictures: choose another one."
        )
    return by_name[0]


def _pixel(pixel: Point, chosen: ChosenPictures) -> Array:
    """Return a pixel of the picture as it was sent in the picture as it is used."""
    camera, (width, height) = chosen.scan.camera, chosen.original_size
    ratio = np.array([camera.width / width, camera.height / height])
    inside = 0 <= pixel[0] < width and 0 <= pixel[1] < height
    if not inside:
        raise InvalidScanError(
            f"scale: the pixel ({pixel[0]:g}, {pixel[1]:g}) is outside of a picture of {width} x {height} pixels."
        )
    return np.asarray((np.array(pixel) + 0.5) * ratio - 0.5)
