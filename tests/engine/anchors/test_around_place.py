"""Which anchors a phone may see whose place is nearly known."""

from __future__ import annotations

from dataclasses import replace

import pytest

from app.engine.anchors.anchor import AnchorSpec, AroundPlace, Poi
from app.geometry.camera_hint import parse_camera_hint

AROUND = AroundPlace(
    floor_id="0", x=10.0, y=5.0, phone_m=2.0, heading_deg=170.0, half_view_deg=35.0, sees_m=12.0
)


def anchor(*places: tuple[float, float], floor: str = "0") -> AnchorSpec:
    """Return an anchor that hangs above the phone and has POIs at these places."""
    camera = parse_camera_hint("500,500,320,240")
    assert camera is not None
    return AnchorSpec(
        venue_id="v",
        floor_id=floor,
        x=10.0,
        y=5.0,
        height_m=2.5,
        heading_deg=None,
        camera=camera,
        pois=tuple(Poi(id="p", region_px=(), x=x, y=y, distance_m=3.0) for x, y in places),
    )


@pytest.mark.parametrize(
    ("places", "is_seen"),
    [
        ([(4.0, 5.0)], True),
        ([(16.0, 5.0)], False),
        ([(11.0, 5.0)], True),
        ([(-6.0, 5.0)], False),
        ([(16.0, 5.0), (4.0, 5.0)], True),
        # 61 degrees aside: in view from two metres beside the point, not from the point itself.
        ([(8.0, 11.0)], False),
        ([(6.0, 9.5)], True),
        ([(4.0, 4.5)], True),
    ],
)
def test_an_anchor_is_asked_where_the_phone_may_see_one_of_its_pois(
    places: list[tuple[float, float]], is_seen: bool
) -> None:
    assert AROUND.has_anchor(anchor(*places)) == is_seen


def test_anchors_of_other_floors_are_not_asked() -> None:
    assert not AROUND.has_anchor(anchor((4.0, 5.0), floor="1"))


def test_on_a_floor_with_walls_a_near_anchor_is_asked_whatever_its_pois() -> None:
    aside = anchor((16.0, 5.0))
    assert not AROUND.has_anchor(aside)
    assert AROUND.has_anchor(aside, has_walls=True)
    assert not AROUND.has_anchor(anchor((4.0, 5.0), floor="1"), has_walls=True)
    assert not AROUND.has_anchor(replace(aside, x=30.0), has_walls=True)


def test_a_phone_is_no_farther_than_its_place_is_uncertain() -> None:
    assert AROUND.has_phone(11.0, 6.0)
    assert not AROUND.has_phone(12.0, 6.0)
