"""JSON bodies have the types that OpenAPI describes: true is no number, and a bounding box is one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.api.key_rows import ANCHOR, FLOOR, VENUE
from tests.plans import collection, landmark
from tests.server import Server, assert_problem

IDENTITY = np.eye(4).tolist()
PAIRS = [{"world": [0, 0, 0], "plan": [1, 1]}, {"world": [5, 0, 0], "plan": [6, 1]}]


@pytest.fixture
def site(empty: Server) -> Server:
    empty.add_venue(VENUE)
    assert empty.client.put(f"/venues/{VENUE}/floors/0", json=FLOOR).status_code == 200
    return empty


def test_whole_numbers_may_have_a_decimal_point(site: Server) -> None:
    answer = site.client.put(
        f"/venues/{VENUE}/floors/2", json={**FLOOR, "level": 2.0, "z_min_m": 7, "z_max_m": 9}
    )
    assert (answer.status_code, answer.json()["level"]) == (200, 2)


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("floors/0", {**FLOOR, "level": False}),
        ("floors/0", {**FLOOR, "level": "0"}),
        ("floors/0", {**FLOOR, "level": 0.5}),
        ("floors/0", {**FLOOR, "z_max_m": "3"}),
        ("floors/0", {**FLOOR, "plan_from_world": [*IDENTITY[:3], [0, 0, 0, "1"]]}),
        ("floors/0", {**FLOOR, "plan_from_world": [*IDENTITY[:3], [0, 0, 0, True]]}),
        ("floors/0", {**FLOOR, "plan_from_world": {"correspondences": PAIRS, "scale": 2}}),
        ("floors/0", {**FLOOR, "plan_from_world": {"correspondences": [{**PAIRS[0], "weight": 1}, PAIRS[1]]}}),
        ("floors/0/features", {**collection(landmark("a", 1, 1)), "bbox": [None, None]}),
        ("floors/0/features", {**collection(landmark("a", 1, 1)), "bbox": [0, 0, 1]}),
        ("floors/0/features", {**collection(landmark("a", 1, 1)), "bbox": [0, 0, 1, True]}),
        ("floors/0/features", collection({**landmark("a", 1, 1), "bbox": "0,0,1,1"})),
    ],
    ids=repr,
)  # fmt: skip
def test_a_value_of_another_type_is_refused(site: Server, path: str, body: dict[str, Any]) -> None:
    with site.unchanged():
        assert_problem(site.client.put(f"/venues/{VENUE}/{path}", json=body), 422)


@pytest.mark.parametrize(
    "change",
    [{"store_images": 0}, {"store_images": "false"}, {"height_m": True}, {"max_age_s": "60"}],
    ids=repr,
)
def test_an_anchor_of_another_type_is_refused(site: Server, change: dict[str, Any]) -> None:
    assert_problem(site.client.put("/anchors/hall", json={**ANCHOR, **change}), 422, "invalid_request")
    assert site.client.put("/anchors/hall", json=ANCHOR).status_code == 200


@pytest.mark.parametrize("box", [None, [0, 0, 1, 1], [0, 0, 0, 1.5, 1, 1]])
def test_a_bounding_box_is_taken(site: Server, box: object) -> None:
    body = {**collection({**landmark("a", 1, 1), "bbox": box}), "bbox": box}
    assert site.client.put(f"/venues/{VENUE}/floors/0/features", json=body).status_code == 200


def test_keys_and_tokens_live_for_a_while(site: Server) -> None:
    for body in ({"expires_in_s": True}, {"expires_in_s": 1e300}, {"expires_in_s": "60"}):
        key = {"name": "a", "scope": "locate", **body}
        assert_problem(site.client.post("/keys", json=key), 422, "invalid_request")
