"""Where a scan lies in the world of a venue, and whether it may replace the map that serves."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from app.engine.mapping.build_map import scan_placement
from app.engine.mapping.options import BuildOptions
from app.engine.mapping.register_scan import Registration, UnregisteredScanError, middle_of, register_scan
from app.engine.maps.open_map import OpenMap
from app.engine.progress import Progress
from app.engine.query.localizer import Localizer
from app.errors import InvalidScanError
from app.geometry.se3 import Pose, attitude_difference_rad, position_difference_m
from app.importers.frames import FrameSource
from app.limits import limit
from app.services.examine_scan import WITHOUT_SCALE
from app.storage.maps import MapVersion


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacementOptions:
    """When a scan lies where its own poses say, and when the present map contradicts it."""

    same_frame_m: float = limit(
        0.05,
        "A registration within this of the scan's own frame says that the frame is the world already.",
        chosen="By hand: the scan's own poses are then better than any registration.",
    )
    same_frame_rad: float = limit(
        0.0175,
        "The same for the attitude: one degree.",
        chosen="By hand: as same_frame_m, over three metres.",
    )
    given_m: float = limit(
        0.5,
        "A given placement further than this from where the present map finds the scan contradicts the map.",
        chosen="By hand: what a placement by tape or on a plan is off by.",
    )
    given_rad: float = limit(
        0.0873,
        "The same for the attitude: five degrees.",
        chosen="By hand: as given_m, over six metres.",
    )
    upright_rad: float = limit(
        0.05,
        "A world whose z leans by less than this from what a registered scan's gravity says has z up.",
        chosen="By hand: three degrees, what gravity and registration are off by together.",
    )
    contradicting_frames: int = limit(
        5,
        "Frames of the scan located in the present map, but apart from each other, that contradict it.",
        chosen="By hand: fewer may be look-alikes.",
    )
    contradicting_share: float = limit(
        0.25,
        "The same as a share of the frames that were tried.",
        chosen="By hand: a part of the scan is elsewhere.",
    )


OPTIONS = PlacementOptions()
# Floors that a message names before it counts the rest.
NAMED_FLOORS = 3
LEANING_WORLD = (
    "The z axis of the map before does not point up, by this scan's gravity: the new map has another, upright world. "
    "Floors and anchors that were placed in the world before have to be placed anew."
)


@dataclass(frozen=True, slots=True)
class PresentMap:
    """The map that serves, its version, and the ids of the floors whose plan was placed in its world."""

    map: OpenMap
    version: MapVersion
    placed_floors: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Placement:
    """`world_from_scan`, and where it comes from: `given`, `gravity`, `registered` or `scan_frame`; `z_up` says
    whether the world's z axis is known to point up by it."""

    world_from_scan: Pose
    source: str
    z_up: bool
    figures: dict[str, Any]
    warnings: tuple[str, ...] = ()


def place_scan(
    source: FrameSource,
    options: BuildOptions,
    present: PresentMap | None,
    executor: Executor,
    progress: Progress,
) -> Placement:
    """Return where a scan lies in the world that the present map gives, or that the scan itself begins.

    Raises `InvalidScanError` when the scan can't extend the present map, or must not replace it without `force`.
    """
    own = scan_placement(options, source)
    given = options.world_from_scan is not None
    by_gravity = options.gravity is not None or source.gravity is not None
    by_itself = "given" if given else "gravity" if by_gravity else "scan_frame"
    alone = Placement(own, by_itself, given or by_gravity, {})
    in_metres = present is not None and source.has_scale and present.version.has_scale
    if present is not None and options.mode == "extend" and not in_metres and not given:
        raise InvalidScanError(WITHOUT_SCALE)
    if present is None or not in_metres:
        return alone
    try:
        found: Registration | UnregisteredScanError = register_scan(
            source, Localizer(present.map), executor, progress
        )
    except UnregisteredScanError as error:
        found = error
    return beside_map(found, alone, middle_of(source.frames), options, present.version, present.placed_floors)


def beside_map(
    found: Registration | UnregisteredScanError,
    alone: Placement,
    middle: Pose,
    options: BuildOptions,
    present: MapVersion,
    placed_floors: tuple[str, ...],
) -> Placement:
    """Return where a scan lies by what it says itself, `alone`, and by where the present map finds it, if it does.

    `middle` is the pose of the middle of the scan in its frame; `placed_floors` are those whose plan was placed in the
    present map's world. Raises `InvalidScanError` as `place_scan`.
    """
    if isinstance(found, UnregisteredScanError):
        return _unregistered(found, alone, options, placed_floors)
    if alone.source == "given":
        return _given(found, alone, middle, options, placed_floors)
    return _registered(found, alone, middle, options, present)


def _unregistered(
    error: UnregisteredScanError, alone: Placement, options: BuildOptions, placed_floors: tuple[str, ...]
) -> Placement:
    """Return the scan's own placement, for one whose place in the present map was not found."""
    figures = {"tried": error.tried, "located": error.located, "agreeing": error.agreeing}
    if options.world_from_scan is None and options.mode == "extend":
        raise error
    if options.world_from_scan is not None and not contradicts(error):
        # Another part of the same world, as the given placement says.
        return replace(alone, figures=figures)
    return replace(alone, figures=figures, warnings=replacement_warnings(error, options, placed_floors))


def _given(
    found: Registration,
    given: Placement,
    middle: Pose,
    options: BuildOptions,
    placed_floors: tuple[str, ...],
) -> Placement:
    """Return the given placement. Raises `InvalidScanError` when the present map puts the scan elsewhere, and its
    keyframes stay in use or floors were placed in its world, unless `force` is given."""
    figures = {"tried": found.tried, "located": found.located, "agreeing": found.agreeing}
    by_map, by_admin = found.world_from_scan @ middle, given.world_from_scan @ middle
    away_m = position_difference_m(by_map, by_admin)
    away_rad = attitude_difference_rad(by_map, by_admin)
    if away_m < OPTIONS.given_m and away_rad < OPTIONS.given_rad:
        return replace(given, figures=figures)
    told = (
        f"world_from_scan puts the middle of the scan {away_m:.2f} m and {np.degrees(away_rad):.1f} degrees from where "
        f"the present map finds it, by {found.agreeing} of {found.tried} frames"
    )
    if placed_floors:
        told += f"; the plan of {_listed(placed_floors)} was placed in the world of the present map"
    if not options.force and (options.mode == "extend" or placed_floors):
        raise InvalidScanError(
            f"{told}. Leave world_from_scan out to place the scan by the map, or check that it isn't inverted. If the "
            'map is what is wrong, or two places look alike, give "force": true to build all the same.'
        )
    return replace(given, figures=figures, warnings=(f"{told}.",))


def _registered(
    found: Registration, alone: Placement, middle: Pose, options: BuildOptions, present: MapVersion
) -> Placement:
    """Return the placement of a scan that was found in the present map."""
    own = alone.world_from_scan
    # When the scan is in the present map's frame already, its own poses are better than any registration.
    same = _is_near(found.world_from_scan @ middle, own @ middle)
    world_from_scan = own if same else found.world_from_scan
    figures = {"tried": found.tried, "located": found.located, "agreeing": found.agreeing}
    if present.z_up or alone.source != "gravity":
        return Placement(world_from_scan, "registered", present.z_up, figures)
    # What gravity makes upright turns the present world by as much as that one leans.
    leaning = (world_from_scan @ own.inverse()).rotation[2, 2] < np.cos(OPTIONS.upright_rad)
    if not leaning or options.mode == "extend":
        return Placement(world_from_scan, "registered", not leaning, figures)
    return Placement(own, "gravity", True, figures, (LEANING_WORLD,))


def contradicts(error: UnregisteredScanError) -> bool:
    """Return whether the present map knows a scan's pictures, but puts them elsewhere than the scan's poses say."""
    return (
        error.located >= OPTIONS.contradicting_share * error.tried
        and error.located >= OPTIONS.contradicting_frames
    )


def _is_near(a: Pose, b: Pose) -> bool:
    return (
        position_difference_m(a, b) < OPTIONS.same_frame_m
        and attitude_difference_rad(a, b) < OPTIONS.same_frame_rad
    )


def replacement_warnings(
    error: UnregisteredScanError, options: BuildOptions, placed_floors: tuple[str, ...]
) -> tuple[str, ...]:
    """Return what to warn of when a scan that can't be registered replaces the present map.

    Without `force` it raises `InvalidScanError` in two cases: the present map knows the scan's pictures and puts them
    elsewhere; or floors were placed in the world of the present map, and nothing says where they lie in the new one.
    """
    contradicted = contradicts(error)
    if contradicted:
        found = (
            f"The new scan contradicts the present map: of {error.tried} of its frames the map locates "
            f"{error.located}, and by its poses only {error.agreeing} of them lie as they do in the map"
        )
        remedy = 'If the map is what is wrong, or the place was changed, give "force": true to replace it'
    else:
        found = (
            f"The new scan seems to show another place than the present map: of {error.tried} of its frames the map "
            f"locates {error.located}, so that its place in the world of the present map is not known"
        )
        remedy = (
            "Give world_from_scan if it is known, or scan a part of what the map holds too; or give "
            '"force": true to replace the map, and place the floors anew'
        )
    if placed_floors:
        found += f". In that world the plan of {_listed(placed_floors)} was placed"
    if not options.force and (contradicted or placed_floors):
        raise InvalidScanError(f"{found}. {remedy}.")
    forced = " It was replaced all the same, as force says." if options.force else ""
    anew = " Place the floors anew." if placed_floors else ""
    return (f"{found}.{forced}{anew}",)


def _listed(floors: tuple[str, ...]) -> str:
    shown = ", ".join(floors[:NAMED_FLOORS])
    more = len(floors) - NAMED_FLOORS
    return f"{'floor' if len(floors) == 1 else 'floors'} {shown}" + (f" and {more} more" if more > 0 else "")
