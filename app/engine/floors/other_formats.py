"""What people send in place of a GeoJSON FeatureCollection, by how it begins."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping

from app.engine.floors.sentences import short

_HEAD_BYTES = 1024
_XML = rb"\s*(?:<\?xml[^>]*>\s*)?(?:<!--.*?-->\s*)*"
_FORMATS = (
    (_XML + rb"<kml", "The body is KML"),
    (_XML + rb"<gpx", "The body is GPX"),
    (_XML + rb"<osm", "The body is OpenStreetMap XML, which roomfix import-plan reads"),
    (rb"\s*<", "The body is XML or HTML"),
    (rb"\x00\x00\x27\x0a", "The body is a shapefile"),
    (rb"PK\x03\x04", "The body is a zip, such as of a shapefile"),
    (rb"SQLite format 3\x00", "The body is a GeoPackage or another SQLite file"),
    (rb"fgb\x03", "The body is FlatGeobuf"),
    (rb"\x1f\x8b", "The body is gzip, but no Content-Encoding: gzip says so"),
    (rb"[^\n{}\[\]]*[,;\t][^\n{}\[\]]*\n", "The body is a table, such as CSV"),
)


def other_format(data: bytes) -> str | None:
    """Return what a body that is no JSON is, as the begin of a sentence; None where that is not known."""
    head = data[:_HEAD_BYTES].removeprefix(b"\xef\xbb\xbf")
    if not head.strip():
        return "The body is empty"
    if _is_sequence(data):
        return "The body is a sequence of features, one a line"
    return next((what for magic, what in _FORMATS if re.match(magic, head, re.DOTALL)), None)


def _is_sequence(data: bytes) -> bool:
    """Whether a whole JSON object stands in the first of several lines (RFC 8142 has a separator before it)."""
    first, _, others = data.partition(b"\n")
    if not others.strip():
        return False
    try:
        return isinstance(json.loads(first.lstrip(b"\x1e")), dict)
    except (ValueError, RecursionError):
        return False


def other_json(value: object) -> str:
    """Return what a JSON value is that is no FeatureCollection, as the end of a sentence; empty where unknown."""
    if isinstance(value, list):
        return ", not a list"
    if not isinstance(value, Mapping):
        return ""
    kind = value.get("type")
    if kind == "Topology":
        return ", not TopoJSON"
    if kind is None and ("geometryType" in value or "spatialReference" in value):
        return ", not Esri JSON"
    return "" if kind is None else f", not {short(kind)}"
