"""Where a scan lies by its own word and by where the present map finds it: each rule at both sides of its limit."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest

from app.engine.mapping.options import BuildOptions
from app.engine.mapping.register_scan import Registration, UnregisteredScanError
from app.errors import InvalidScanError
from app.geometry.se3 import Pose, rotation_from_vector
from app.services.builds.place_scan import (
    LEANING_WORLD,
    OPTIONS,
    Placement,
    beside_map,
    contradicts,
    replacement_warnings,
)
from app.storage.maps import MapVersion

HERE = Pose.identity()
# Where the middle of the scan is in its frame: far from the origin, so that a turn moves what is compared there.
MIDDLE = Pose(rotation_from_vector([0.0, 0.0, 1.0]), np.array([4.0, -3.0, 1.5]))
FIGURES = {"tried": 40, "located": 30, "agreeing": 20}
EPSILON = 1e-3


def turned(rad: float, axis: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> Pose:
    """Return a turn of the world about the middle of the scan."""
    rotation = rotation_from_vector(np.array(axis) * rad)
    return Pose(rotation, MIDDLE.translation - rotation @ MIDDLE.translation)


def moved(metres: float) -> Pose:
    return Pose(np.eye(3), np.array([0.0, metres, 0.0]))


def version(**placement: object) -> MapVersion:
    return MapVersion(
        venue_id="v",
        version=1,
        build_id=None,
        artifact_blob="",
        index_blob="",
        statistics={"placement": placement},
        created_at=datetime(2026, 1, 1, tzinfo=UTC),
    )


UPRIGHT = version(z_up=True)
LEANING = version(z_up=False)


def placed(
    found: Registration | UnregisteredScanError | Pose,
    alone: Placement,
    present: MapVersion = UPRIGHT,
    floors: tuple[str, ...] = (),
    **options: Any,
) -> Placement:
    if isinstance(found, Pose):
        found = Registration(found, *FIGURES.values())
    return beside_map(found, alone, MIDDLE, BuildOptions(**options), present, floors)


def given(world_from_scan: Pose = HERE) -> Placement:
    return Placement(world_from_scan, "given", True, {})


def by_gravity(world_from_scan: Pose = HERE) -> Placement:
    return Placement(world_from_scan, "gravity", True, {})


def in_own_frame(world_from_scan: Pose = HERE) -> Placement:
    return Placement(world_from_scan, "scan_frame", False, {})


def same(a: Pose, b: Pose) -> bool:
    return bool(np.allclose(a.matrix, b.matrix, atol=1e-12))


@pytest.mark.parametrize(
    ("apart", "is_own"),
    [
        (moved(OPTIONS.same_frame_m - EPSILON), True),
        (moved(OPTIONS.same_frame_m + EPSILON), False),
        (turned(OPTIONS.same_frame_rad - EPSILON), True),
        (turned(OPTIONS.same_frame_rad + EPSILON), False),
    ],
)
def test_a_scan_in_the_present_frame_keeps_its_own_poses(apart: Pose, is_own: bool) -> None:
    found = placed(apart, in_own_frame())
    assert same(found.world_from_scan, HERE if is_own else apart)
    assert (found.source, found.z_up, found.figures, found.warnings) == ("registered", True, FIGURES, ())


def test_a_registered_scan_has_up_as_the_present_map_has_it() -> None:
    far = moved(3.0)
    for present, z_up in ((UPRIGHT, True), (LEANING, False)):
        assert placed(far, in_own_frame(), present).z_up is z_up
    # Of an upright map gravity says nothing new, whatever the scan's own is.
    tilted = turned(0.5, (1.0, 0.0, 0.0))
    found = placed(tilted, by_gravity(), UPRIGHT)
    assert same(found.world_from_scan, tilted)
    assert (found.source, found.z_up, found.warnings) == ("registered", True, ())


@pytest.mark.parametrize(
    ("lean_rad", "mode", "source", "z_up"),
    [
        (OPTIONS.upright_rad - EPSILON, "replace", "registered", True),
        (OPTIONS.upright_rad - EPSILON, "extend", "registered", True),
        (OPTIONS.upright_rad + EPSILON, "extend", "registered", False),
        (OPTIONS.upright_rad + EPSILON, "replace", "gravity", True),
    ],
)
def test_gravity_says_whether_the_present_world_leans(
    lean_rad: float, mode: str, source: str, z_up: bool
) -> None:
    # The scan's frame is turned already: what counts is how it lies in the world, not the world's turn alone.
    own = turned(1.0)
    leaning = turned(lean_rad, (1.0, 0.0, 0.0)) @ own
    found = placed(leaning, by_gravity(own), LEANING, mode=mode)
    assert (found.source, found.z_up, found.figures if source == "registered" else {}) == (
        source,
        z_up,
        FIGURES if source == "registered" else {},
    )
    assert same(found.world_from_scan, own if source == "gravity" else leaning)
    assert found.warnings == ((LEANING_WORLD,) if source == "gravity" else ())


@pytest.mark.parametrize(
    ("apart", "agrees"),
    [
        (moved(OPTIONS.given_m - EPSILON), True),
        (moved(OPTIONS.given_m + EPSILON), False),
        (turned(OPTIONS.given_rad - EPSILON), True),
        (turned(OPTIONS.given_rad + EPSILON), False),
    ],
)
def test_a_given_placement_may_be_off_by_a_little(apart: Pose, agrees: bool) -> None:
    found = placed(apart, given())
    assert same(found.world_from_scan, HERE)
    assert (found.source, found.z_up, found.figures) == ("given", True, FIGURES)
    assert (found.warnings == ()) is agrees
    if agrees:
        assert placed(apart, given(), floors=("a",), mode="extend").warnings == ()
        return
    for options in ({"mode": "extend"}, {"floors": ("a",)}, {"mode": "extend", "floors": ("a",)}):
        with pytest.raises(InvalidScanError, match='"force": true'):
            placed(apart, given(), **options)
        assert placed(apart, given(), force=True, **options).warnings


def test_the_warning_of_a_given_placement_says_what_is_off() -> None:
    (warning,) = placed(turned(0.2) @ moved(0.0), given()).warnings
    assert "0.00 m and 11.5 degrees" in warning
    assert "20 of 40 frames" in warning
    assert "plan" not in warning
    (warning,) = placed(moved(1.0), given(), floors=("a", "b"), force=True).warnings
    assert "1.00 m and 0.0 degrees" in warning
    assert "the plan of floors a, b was placed" in warning


FEW = UnregisteredScanError(40, 4, 2)
CONTRADICTING = UnregisteredScanError(40, 30, 2)


@pytest.mark.parametrize(
    ("tried", "located", "expected"),
    [
        (4, OPTIONS.contradicting_frames, True),
        (4, OPTIONS.contradicting_frames - 1, False),
        (40, 10, True),
        (40, 9, False),
    ],
)
def test_a_map_contradicts_by_enough_frames_and_a_share_of_them(
    tried: int, located: int, expected: bool
) -> None:
    assert contradicts(UnregisteredScanError(tried, located, 0)) is expected


def test_a_scan_that_is_not_found_extends_only_where_its_place_is_given() -> None:
    with pytest.raises(UnregisteredScanError):
        placed(FEW, in_own_frame(), mode="extend")
    with pytest.raises(UnregisteredScanError):
        placed(FEW, in_own_frame(), mode="extend", force=True)
    figures = {"tried": 40, "located": 4, "agreeing": 2}
    found = placed(FEW, given(), mode="extend", world_from_scan=HERE)
    assert found == replace(given(), figures=figures)
    # Floors that were placed stay where they are: the given placement is in their world.
    assert placed(FEW, given(), floors=("a",), world_from_scan=HERE).warnings == ()
    with pytest.raises(InvalidScanError, match="contradicts the present map"):
        placed(CONTRADICTING, given(), mode="extend", world_from_scan=HERE)
    forced = placed(CONTRADICTING, given(), mode="extend", world_from_scan=HERE, force=True)
    assert forced.figures == {"tried": 40, "located": 30, "agreeing": 2}
    assert "as force says" in forced.warnings[0]


def test_a_scan_that_is_not_found_replaces_with_a_warning() -> None:
    found = placed(FEW, in_own_frame())
    assert (found.source, found.z_up) == ("scan_frame", False)
    (warning,) = found.warnings
    assert "seems to show another place" in warning
    assert "of 40 of its frames the map locates 4" in warning
    assert warning.endswith("is not known.")
    with pytest.raises(InvalidScanError, match="contradicts the present map"):
        placed(CONTRADICTING, in_own_frame())
    with pytest.raises(InvalidScanError, match=r"plan of floor a was placed.*Give world_from_scan"):
        placed(FEW, in_own_frame(), floors=("a",))


def test_what_is_said_of_a_replaced_map() -> None:
    forced, floors = BuildOptions(force=True), ("a", "b", "c", "d", "e")
    (plain,) = replacement_warnings(FEW, forced, ())
    assert plain.endswith("is not known. It was replaced all the same, as force says.")
    (warning,) = replacement_warnings(FEW, forced, floors)
    assert "plan of floors a, b, c and 2 more was placed" in warning
    assert warning.endswith("as force says. Place the floors anew.")
    assert "floors a, b, c was" in replacement_warnings(FEW, forced, floors[:3])[0]
    (warning,) = replacement_warnings(CONTRADICTING, forced, ())
    assert "locates 30, and by its poses only 2 of them lie" in warning
    assert "another place" not in warning
    with pytest.raises(InvalidScanError, match="If the map is what is wrong"):
        replacement_warnings(CONTRADICTING, BuildOptions(), ())
