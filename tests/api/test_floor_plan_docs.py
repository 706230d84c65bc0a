"""The examples of docs/floor-plans.md are what the server takes and answers."""

from __future__ import annotations

import json
import re
from pathlib import Path

from tests.plans import put_features
from tests.server import Server

TEXT = (Path(__file__).parents[2] / "docs" / "floor-plans.md").read_text(encoding="utf-8")
FEATURES, ROUTE = (json.loads(block) for block in re.findall(r"```json\n(.*?)```", TEXT, re.DOTALL))
COUNTS = json.loads(re.findall(r"^# (\{.*\})$", TEXT, re.MULTILINE)[0])


def test_the_examples_hold(empty: Server) -> None:
    empty.add_venue("museum")
    for level in (0, 1):
        floor = {"name": f"Floor {level}", "level": level, "z_min_m": 3.0 * level, "z_max_m": 3.0 * level + 3}
        assert empty.client.put(f"/venues/museum/floors/{level}", json=floor).status_code == 200
    assert put_features(empty, "0", FEATURES, "museum").json() == COUNTS
    query = {"from": "entrance", "to": "till", "language": "en"}
    found = empty.client.get("/venues/museum/route", params=query).json()
    for step in found["steps"]:
        for more in ("landmark_name", "passing", "mode", "floor", "to_floor", "x", "y"):
            del step[more]
    assert found == ROUTE
