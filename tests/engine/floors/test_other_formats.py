"""What is sent in place of a GeoJSON FeatureCollection is named."""

from __future__ import annotations

import gzip
import json
from typing import Any

import pytest

from app.engine.floors.collection import parse_json, read_collection
from app.errors import InvalidInputError
from tests.plans import landmark

A, B = (json.dumps(landmark(name, 0, 0)).encode() for name in "ab")


def refusal(body: bytes) -> str:
    with pytest.raises(InvalidInputError) as caught:
        read_collection(parse_json(body), "0")
    assert "FeatureCollection" in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("body", "what"),
    [
        (b"", "empty"),
        (b" \n", "empty"),
        (b'<?xml version="1.0"?>\n<!-- made by hand -->\n<kml xmlns="x"/>', "KML"),
        (b"\xef\xbb\xbf<gpx/>", "GPX"),
        (b"<osm/>", "OpenStreetMap XML, which roomfix import-plan reads"),
        (b"<html/>", "XML or HTML"),
        (b"name,x,y\nTill,1,2\n", "a table"),
        (b"name;x;y\r\nTill;1,5;2,5\r\n", "a table"),
        (A + b"\n" + B + b"\n", "a sequence of features, one a line"),
        (b"\x1e" + A + b"\n\x1e" + B, "a sequence of features, one a line"),
        (b"PK\x03\x04" + bytes(30), "a zip"),
        (b"\x00\x00\x27\x0a" + bytes(96), "a shapefile"),
        (b"SQLite format 3\x00" + bytes(96), "a GeoPackage"),
        (gzip.compress(A), "gzip, but no Content-Encoding"),
    ],
)
def test_files_are_named(body: bytes, what: str) -> None:
    assert f"The body is {what}" in refusal(body)


@pytest.mark.parametrize(
    ("value", "what"),
    [
        ({"type": "Topology", "arcs": []}, "not TopoJSON"),
        ({"geometryType": "esriGeometryPoint", "features": []}, "not Esri JSON"),
        (landmark("a", 0, 0), "not 'Feature'"),
        ([landmark("a", 0, 0)], "not a list"),
    ],
)
def test_other_json_is_named(value: Any, what: str) -> None:
    assert what in refusal(json.dumps(value).encode())


def test_a_byte_order_mark_is_no_harm() -> None:
    body = json.dumps({"type": "FeatureCollection", "features": [landmark("a", 0, 0)]})
    for encoding in ("utf-8-sig", "utf-16"):
        assert list(read_collection(parse_json(body.encode(encoding)), "0")[1].landmarks) == ["a"]


def test_broken_json_is_located() -> None:
    assert "line 2 column" in refusal(b'{"type": "FeatureCollection",\n "features": [],}')
