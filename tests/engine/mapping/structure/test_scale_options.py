"""What a request may say of the scale, and what it may not."""

from __future__ import annotations

from typing import Any

import pytest

from app.engine.mapping.options import parse_build_options
from app.engine.mapping.structure.scale_options import (
    KnownDistance,
    KnownHeight,
    KnownMarker,
    KnownPlaces,
    frames_of,
    parse_scale,
)
from app.errors import InvalidInputError


def test_all_kinds_are_read() -> None:
    distance = parse_scale({"distance_m": 1.25, "frame": 12.5, "pixels": [[1, 2], [3, 4]]})
    assert distance == KnownDistance(1.25, "12.5", ((1.0, 2.0), (3.0, 4.0)))
    assert frames_of(distance) == ("12.5",)
    assert parse_scale({"marker_m": 0.16}) == KnownMarker(0.16)
    assert parse_scale({"camera_height_m": 1.5}) == KnownHeight(1.5)
    places = parse_scale(
        {"correspondences": [{"frame": n, "plan": [n, 2 * n], "pixel": None} for n in range(3)]}
    )
    assert isinstance(places, KnownPlaces)
    assert frames_of(places) == ("0.0", "1.0", "2.0")
    assert parse_scale(None) is None


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (1.5, "scale must be one of"),
        ({}, "scale must be one of"),
        ({"marker_m": 0.1, "camera_height_m": 1.5}, "scale must be one of"),
        ({"marker_m": 0}, "scale.marker_m must be a number of metres above 0"),
        ({"camera_height_m": "1.5"}, "scale.camera_height_m must be a finite number"),
        ({"distance_m": 1, "frame": "a.jpg"}, "scale.pixels must be two pixels"),
        ({"distance_m": 1, "frame": -1, "pixels": [[1, 2], [3, 4]]}, "scale.frame must be the name"),
        ({"distance_m": 1, "frame": 1, "pixels": [[1, 2], [3]]}, "scale.pixels must be two numbers"),
        ({"correspondences": [{"frame": 1, "plan": [0, 0]}]}, "scale.correspondences must be 3 or more"),
        ({"correspondences": [{"frame": 1, "at": [0, 0]}] * 3}, "Each of scale.correspondences"),
        ({"correspondences": [{"frame": 1, "plan": [0, None]}] * 3}, "plan must be two numbers"),
    ],
)
def test_what_makes_no_sense_is_named(value: Any, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        parse_scale(value)


def test_poses_may_be_estimated() -> None:
    options = parse_build_options({"poses": "estimate", "scale": {"marker_m": 0.16}})
    assert options.scan.estimate_poses
    assert options.scan.convention.poses == "world_from_camera"
    assert not parse_build_options({}).scan.estimate_poses
