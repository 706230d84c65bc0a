"""docs/where-on-earth.md: its example gives the numbers that it prints."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Any

import pytest

from app.api.bodies.earth import GEOPOSE, ORIGIN, GeoPoseBody, OriginBody
from app.api.locate import EXAMPLE
from app.engine.floors.earth import Earth
from app.geometry.se3 import Pose
from app.storage.floors import list_floors
from tests.api.test_locate import put_floor
from tests.server import Server

PAGE = Path(__file__).parents[2] / "docs" / "where-on-earth.md"
TEXT = PAGE.read_text(encoding="utf-8")
NAMES = ("plan_from_world", "pose", "geopose", "features")
BLOCKS = [json.loads(block) for block in re.findall(r"```json\n(.*?)```", TEXT, re.DOTALL)]
PRINTED: dict[str, Any] = dict(zip(NAMES, BLOCKS, strict=False))
CALLS = [shlex.split(block) for block in re.findall(r"^```sh\n(curl.*?)```", TEXT, re.DOTALL | re.MULTILINE)]


def call(server: Server, words: list[str]) -> Any:
    """Make the call of a curl command to a server."""
    url = next(word for word in words if word.startswith("$URL"))
    method = words[words.index("-X") + 1] if "-X" in words else "GET"
    body = words[words.index("-d") + 1] if "-d" in words else None
    headers = {"Content-Type": "application/json"} if body else {}
    return server.client.request(method, url.removeprefix("$URL"), content=body, headers=headers)


def test_the_example_of_the_page(empty: Server) -> None:
    empty.add_venue("museum")
    put_floor(empty, "museum", "0", 0, 3, plan_from_world=PRINTED["plan_from_world"])
    desk = {**PRINTED["features"]["features"][0], "geometry": {"type": "Point", "coordinates": [12, 5]}}
    features = {"type": "FeatureCollection", "features": [desk]}
    assert empty.client.put("/venues/museum/floors/0/features", json=features).status_code == 200
    patch, get = CALLS[:2]
    assert call(empty, patch).json()["origin"] == ORIGIN
    answer = call(empty, get)
    assert answer.json() == PRINTED["features"]
    resources = empty.client.app.state.roomfix.services.resources  # type: ignore[attr-defined]
    with resources.database.read() as connection:
        floors = list_floors(connection, "museum")
    position, quaternion = PRINTED["pose"]["position"], PRINTED["pose"]["quaternion"]
    pose = Pose.from_quaternion([position[a] for a in "xyz"], [quaternion[a] for a in "xyzw"])
    geopose = Earth(OriginBody.model_validate(ORIGIN).to_origin(), floors).geopose(pose)
    assert geopose is not None
    found = GeoPoseBody.of(geopose).model_dump()
    for part, printed in PRINTED["geopose"].items():
        assert found[part] == pytest.approx(printed, abs=2e-11 if part == "position" else 1e-6), part


def test_the_example_of_the_schema_is_that_of_the_page() -> None:
    assert (PRINTED["geopose"], PRINTED["pose"]) == (GEOPOSE, EXAMPLE["pose"])
