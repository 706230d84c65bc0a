"""Features whose coordinates are no plan metres are refused together; what QGIS and others write is read."""

from __future__ import annotations

from typing import Any

import pytest

from app.engine.floors.collection import parse_features
from app.engine.floors.floor import PlanImage
from app.engine.floors.model import FloorFeatures
from app.errors import InvalidInputError
from tests.plans import area, collection, feature, landmark, link

PLAN = PlanImage(
    blob="b",
    media_type="image/png",
    width_px=1000,
    height_px=800,
    meters_per_pixel=0.02,
    origin_px=(100.0, 700.0),
)
IN_BERLIN = (landmark("entrance", 13.37701, 52.51622), landmark("till", 13.37748, 52.5165))


def read(value: object, plan: PlanImage | None = None) -> FloorFeatures:
    return parse_features(value, "0", ["0", "1"], plan)[1]


def refusal(value: object, plan: PlanImage | None = None) -> str:
    with pytest.raises(InvalidInputError) as caught:
        read(value, plan)
    return str(caught.value)


def named(name: str) -> dict[str, Any]:
    return {"type": "name", "properties": {"name": name}}


def test_longitude_and_latitude_are_not_metres() -> None:
    sentence = refusal(collection(*IN_BERLIN))
    assert "within 0.47 mm of each other" in sentence
    assert "Add origin" in sentence
    origin = {"longitude": 13.377, "latitude": 52.516}
    marks = read(collection(*IN_BERLIN, origin=origin)).landmarks
    assert marks["till"].x - marks["entrance"].x == pytest.approx(31.9, abs=0.2)


@pytest.mark.parametrize(
    "features",
    [
        # A path of two kilometres in degrees is long enough for a link.
        (landmark("a", 13.37, 52.51), landmark("b", 13.39, 52.52), link((13.37, 52.51), (13.39, 52.52))),
        tuple(feature("Point", [x, 37.7], kind="poi", name=str(x)) for x in (-122.4, -122.401)),
    ],
)
def test_degrees_of_other_features(features: tuple[dict[str, Any], ...]) -> None:
    assert "longitude and latitude" in refusal(collection(*features))


@pytest.mark.parametrize(
    "features",
    [
        (landmark("only", 13.4, 52.5),),
        # The same place twice says nothing of units.
        (landmark("stairs", 5, 5), feature("Point", [5, 5], kind="poi", id="sign", name="Sign")),
        (landmark("a", 0, 0), landmark("b", 0.06, 0)),
    ],
)
def test_places_that_can_be_metres_are_taken(features: tuple[dict[str, Any], ...]) -> None:
    assert len(read(collection(*features)).landmarks) >= 1


def test_coordinates_of_a_map_grid() -> None:
    equator = collection(landmark("a", 500_100, 300_200), landmark("b", 500_130, 300_210))
    assert "300 km or more from plan (0, 0)" not in refusal(equator)
    assert "500 km or more from plan (0, 0)" in refusal(equator)
    assert "UTM" in refusal(equator)
    berlin = collection(landmark("a", 391_000, 5_820_000), landmark("b", 391_030, 5_820_010))
    assert "Feature 0 ('a'): a position is not finite, or not within 1,000,000 m" in refusal(berlin)
    assert "UTM" in refusal(berlin)
    # A site's own grid may begin at a few kilometres.
    assert read(collection(landmark("a", 5_000, 3_000), landmark("b", 5_040, 3_010)))


@pytest.mark.parametrize(
    "crs",
    [
        named("urn:ogc:def:crs:EPSG::25833"),
        named("EPSG:3857"),
        named("http://www.opengis.net/def/crs/EPSG/0/32633"),
        named("urn:ogc:def:crs:EPSG:6.9:25832"),
        {"type": "EPSG", "properties": {"code": 25833}},
        "EPSG:25833",
    ],
)
def test_a_projected_crs_is_refused(crs: object) -> None:
    square = area("a", 0, 0, 5, 5)
    assert "a map grid" in refusal(collection(square, crs=crs))
    origin = {"longitude": 13.4, "latitude": 52.5}
    assert "EPSG:4326" in refusal(collection(square, crs=crs, origin=origin))


@pytest.mark.parametrize("name", ["urn:ogc:def:crs:OGC:1.3:CRS84", "urn:ogc:def:crs:EPSG::4326", "EPSG:4258"])
def test_a_crs_in_degrees_needs_an_origin(name: str) -> None:
    assert "add origin" in refusal(collection(*IN_BERLIN, crs=named(name)))
    origin = {"longitude": 13.377, "latitude": 52.516}
    assert len(read(collection(*IN_BERLIN, crs=named(name), origin=origin)).landmarks) == 2


@pytest.mark.parametrize("crs", [None, {}, {"type": "name", "properties": None}, named("local plan"), 5])
def test_a_crs_that_names_no_system_is_ignored(crs: object) -> None:
    assert len(read(collection(area("a", 0, 0, 5, 5), crs=crs)).areas) == 1


def test_pixels_of_the_plan_image_are_not_metres() -> None:
    # The image shows 20 x 16 m; in pixels the same places are hundreds.
    in_pixels = collection(landmark("a", 150, 650), landmark("b", 850, 200), area("r", 400, 100, 700, 300))
    assert "inside it if their coordinates are pixels" in refusal(in_pixels, PLAN)
    assert len(read(in_pixels).landmarks) == 2
    in_metres = collection(landmark("a", 1, 1), landmark("b", 15, 10), landmark("yard", 35, 12))
    assert len(read(in_metres, PLAN).landmarks) == 3


@pytest.mark.parametrize(("unit", "count"), [("millimetres", 1000), ("centimetres", 100)])
def test_features_in_another_unit_are_named(unit: str, count: float) -> None:
    places = {"a": (1.5, 1), "b": (15, 10), "c": (9, 12), "d": (16, 3)}
    drawn = collection(*(landmark(name, x * count, y * count) for name, (x, y) in places.items()))
    assert f"inside it if their coordinates are {unit}" in refusal(drawn, PLAN)
    # Without an image nothing says how large the floor is.
    assert len(read(drawn).landmarks) == 4


def test_a_wing_whose_image_shows_a_part_keeps_its_metres() -> None:
    """Far outside in metres, and in no other unit inside."""
    far = collection(landmark("a", -70, 3), landmark("b", 150, 40), landmark("c", 90, -60))
    assert len(read(far, PLAN).landmarks) == 3


@pytest.mark.parametrize(
    "name",
    ["会議室\u3000A", "Salle\u00a0101", "کتاب\u200cخانه", "👩\u200d⚕️", "חדר\u200f 5", "Co\u00adop"],
    ids=["full-width space", "no-break space", "non-joiner", "joiner", "direction", "soft hyphen"],
)
def test_names_in_every_script_are_taken(name: str) -> None:
    (mark,) = read(collection(feature("Point", [0, 0], kind="landmark", name=name))).landmarks.values()
    assert (mark.name, mark.id) == (name, name)


@pytest.mark.parametrize("name", ["a\nb", "a\tb", "a\u2028b", "a\x7f", "\u200b", "\u3000"])
def test_names_that_are_no_line_of_text_are_refused(name: str) -> None:
    assert "without line breaks" in refusal(collection(feature("Point", [0, 0], kind="landmark", name=name)))


def test_a_whole_number_as_tables_write_it_is_an_id() -> None:
    marks = read(
        collection({**landmark("x", 0, 0), "id": 7.0, "properties": {"kind": "poi", "name": "A"}})
    ).pois
    assert list(marks) == ["7"]


def test_a_multi_geometry_of_one_part_is_that_part() -> None:
    ring = [[0, 0], [10, 0], [10, 4], [0, 4], [0, 0]]
    found = read(
        collection(
            feature("MultiPolygon", [[ring]], kind="area", name="Hall"),
            feature("MultiPoint", [[1, 1]], kind="landmark", name="Door"),
            feature("MultiPoint", [[9, 1]], kind="landmark", name="Lift"),
            feature("MultiLineString", [[[1, 1], [9, 1]]], kind="link", id="way"),
            feature("MultiPoint", [[9, 1]], kind="lift", id="up", to_floor="1"),
        )
    )
    assert found.areas[0].polygon.area == 40.0
    assert [(mark.x, mark.y) for mark in found.landmarks.values()] == [(1, 1), (9, 1)]
    assert [(one.id, one.mode) for one in found.links] == [("way", "walk"), ("up", "lift")]


@pytest.mark.parametrize(
    ("geometry", "part", "kind"),
    [
        ("MultiPolygon", [[[0, 0], [1, 0], [1, 1], [0, 0]]], "area"),
        ("MultiPoint", [0, 0], "landmark"),
        ("MultiLineString", [[0, 0], [1, 0]], "link"),
    ],
)
def test_several_parts_are_to_be_split(geometry: str, part: object, kind: str) -> None:
    sentence = refusal(collection(feature(geometry, [part, part, part], kind=kind, name="A")))
    assert f"its {geometry} has 3 parts; make a feature of each" in sentence
    assert "Singleparts" in sentence
    assert "must be a" in refusal(collection(feature(geometry, [], kind=kind, name="A")))


@pytest.mark.parametrize("inside", [{"id": None}, {"id": ""}, {"id": "  "}, {}])
def test_an_empty_id_does_not_hide_the_features_own(inside: dict[str, Any]) -> None:
    entry = feature("Point", [0, 0], kind="landmark", name="Entrance", **inside)
    assert list(read(collection({**entry, "id": "ent"})).landmarks) == ["ent"]
    assert list(read(collection({**entry, "id": 7})).landmarks) == ["7"]
    assert list(read(collection({**entry, "id": None})).landmarks) == ["Entrance"]
    wrong = {**entry, "id": "ent", "geometry": {"type": "Point", "coordinates": ["x", 0]}}
    assert refusal(collection(wrong)).startswith("Feature 0 ('ent'):")


def test_an_empty_end_does_not_hide_the_other_spelling() -> None:
    way = link((0, 0), (5, 0), **{"from": None, "from_landmark": "a", "to": None})
    found = read(collection(landmark("a", 0, 0), landmark("b", 5, 0), way))
    assert (found.links[0].start, found.links[0].end) == ("a", None)
