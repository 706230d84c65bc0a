"""The WRLD Indoor Map Format: rooms, paths and ways between levels, and files that are damaged."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from app.errors import InvalidInputError
from app.importers.plans import wrld
from app.importers.plans.files import open_plan_files
from app.importers.plans.model import IndoorLevel
from tests.importers.plans.wrld_maps import files, write


def of_kind(level: IndoorLevel, kind: str) -> list[dict[str, Any]]:
    return [f["properties"] for f in level.features["features"] if f["properties"]["kind"] == kind]


def test_levels_rooms_and_paths(tmp_path: Path) -> None:
    found = wrld.read(open_plan_files(write(tmp_path, files())))
    assert (found.id, found.name, found.paths) == ("house", "The house", 4)
    assert [(level.id, level.name, level.order) for level in found.levels] == [
        ("0", "Level 0", 0),
        ("1", "Level 1", 1),
    ]
    ground, upper = found.levels
    assert [(area["name"], area["category"]) for area in of_kind(ground, "area")] == [
        ("Office", "room"),
        ("Stairs", "stairs"),
    ]
    assert [(link["mode"], link.get("to_floor")) for link in of_kind(ground, "link")] == [
        ("walk", None),
        ("stairs", "1"),
    ]
    assert [(link["mode"], link.get("to_floor")) for link in of_kind(upper, "link")] == [
        ("walk", None),
        ("lift", "0"),
    ]


def test_loose_ends_become_landmarks_named_after_their_room(tmp_path: Path) -> None:
    ground, upper = wrld.read(open_plan_files(write(tmp_path, files()))).levels
    assert {mark["id"]: mark["name"] for mark in of_kind(ground, "landmark")} == {
        "office": "Office",
        "stairs": "Stairs",
    }
    # The lift begins in the middle of a path.
    assert [mark["id"] for mark in of_kind(upper, "landmark")] == ["stairs", "lab", "lift"]


def test_a_map_without_paths(tmp_path: Path) -> None:
    values = files()
    del values["main-paths.json"]
    found = wrld.read(open_plan_files(write(tmp_path, values)))
    assert found.paths == 0
    assert of_kind(found.levels[0], "landmark") == []


def changed(name: str, key: str, value: object) -> dict[str, Any]:
    values = files()
    values[name] = {**values[name], key: value}
    return values


DAMAGED: dict[str, tuple[dict[str, Any], str]] = {
    "no main": ({k: v for k, v in files().items() if k != "main.json"}, "no main.json"),
    "no level": ({k: v for k, v in files().items() if k != "l1.geojson"}, "no l1.geojson"),
    "not JSON": ({**files(), "l0.geojson": "{"}, "l0.geojson is not JSON"),
    "nested": ({**files(), "l0.geojson": "[" * 100_000}, "l0.geojson is not JSON"),
    "a number that is none": ({**files(), "l0.geojson": '{"features": [NaN]}'}, "l0.geojson is not JSON"),
    "too many digits": ({**files(), "main.json": '{"id": ' + "9" * 400 + "}"}, "main.json is not JSON"),
    "beyond the largest number": ({**files(), "main.json": '{"id": 1e999}'}, "main.json is not JSON"),
    "a list": ({**files(), "main.json": []}, "JSON object"),
    "no location": (changed("main.json", "location", None), "location"),
    "words for a location": (changed("main.json", "location", {"coordinates": ["a", "b"]}), "location"),
    "no levels": (changed("main.json", "levels", []), "one level or more"),
    "levels of text": (changed("main.json", "levels", ["a"]), "list of levels"),
    "level without order": (changed("main.json", "levels", [{"id": "a"}]), "z_order"),
    "a file elsewhere": (
        changed(
            "main.json", "levels", [{"id": k, "name": k, "z_order": int(k), "filename": "../x"} for k in "01"]
        ),
        "no file name",
    ),
    "ids that are none": (
        changed("main.json", "levels", [{"id": "a/b", "name": "ä", "z_order": 0}]),
        "letters, digits",
    ),
    "paths of another level": (changed("p0.geojson", "z_order", 7), "z_order 7"),
    "levels that don't fit": (
        changed(
            "main-paths.json", "features", [{**files()["main-paths.json"]["features"][0], "levels": [0]}]
        ),
        "one for each",
    ),
    "a slide": (
        changed(
            "main-paths.json",
            "features",
            [{**files()["main-paths.json"]["features"][0], "properties": {"type": "slide", "id": 1}}],
        ),
        "stairs, elevator, escalator",
    ),
    "no geometry": (
        changed("p0.geojson", "features", [{"properties": {"id": 1, "type": "pathway"}, "geometry": None}]),
        "valid GeoJSON geometry",
    ),
}


@pytest.mark.parametrize("case", DAMAGED)
def test_damaged_maps_are_refused_with_a_reason(tmp_path: Path, case: str) -> None:
    values, hint = DAMAGED[case]
    with pytest.raises(InvalidInputError, match=hint):
        wrld.read(open_plan_files(write(tmp_path, values)))


def test_outlines_of_one_place_are_refused(tmp_path: Path) -> None:
    values = files()
    for room in values["l0.geojson"]["features"]:
        ring = room["geometry"]["coordinates"][0]
        room["geometry"]["coordinates"] = [[ring[0]] * len(ring)]
    with pytest.raises(InvalidInputError, match="valid GeoJSON geometry"):
        wrld.read(open_plan_files(write(tmp_path / "outlines", values)))
