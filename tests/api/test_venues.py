"""Venues, floors, plan images: kept as they were given, and refused with a reason when they can't be meant."""

from __future__ import annotations

import json
from typing import Any

import cv2
import numpy as np
import pytest

from tests.scenes import encode
from tests.server import Server, assert_problem

FLOOR = {"name": "Ground", "level": 0, "z_min_m": -0.5, "z_max_m": 3.0}
PLAN = encode(np.full((60, 80, 3), 200, np.uint8), ".png")
PLAN_FORM = {"meters_per_pixel": "0.05", "origin_px": "10,50"}


@pytest.fixture
def site(empty: Server) -> Server:
    """A server with the venue `site` and its floor `0`."""
    empty.add_venue("site")
    assert empty.client.put("/venues/site/floors/0", json=FLOOR).status_code == 200
    return empty


def put_floor(server: Server, **changes: object) -> Any:
    # Not by `json=`, which refuses NaN: a client need not.
    content = json.dumps({**FLOOR, **changes})
    return server.client.put(
        "/venues/site/floors/0", content=content, headers={"Content-Type": "application/json"}
    )


def test_venues_come_change_and_go(empty: Server) -> None:
    client = empty.client
    assert client.get("/venues").json() == []
    created = client.post("/venues", json={"id": "b-2.x_Y", "name": "Büro №2"})
    assert created.status_code == 201
    assert created.json()["map_version"] is None
    client.post("/venues", json={"id": "a", "name": "A"})
    assert [venue["id"] for venue in client.get("/venues").json()] == ["a", "b-2.x_Y"]
    assert client.patch("/venues/a", json={"name": "Annex"}).json()["name"] == "Annex"
    assert client.get("/venues/a").json()["name"] == "Annex"
    assert client.delete("/venues/a").status_code == 204
    assert_problem(client.get("/venues/a"), 404, "not_found")
    assert_problem(client.patch("/venues/a", json={"name": "x"}), 404, "not_found")
    assert client.get("/venues/b-2.x_Y").json() == created.json()


def test_an_id_that_is_none_is_described_in_words(empty: Server) -> None:
    refused = empty.client.post("/venues", json={"id": "Mein Büro", "name": "Büro"})
    assert assert_problem(refused, 422, "invalid_request").startswith(
        "id: An id has 1 to 64 letters from A to Z"
    )


def test_the_address_of_imports_is_no_venues(empty: Server) -> None:
    created = empty.client.post("/venues", json={"id": "import", "name": "Imports"})
    assert "/venues/import is the address where venues are imported" in assert_problem(
        created, 422, "invalid_input"
    )
    for method in ("GET", "PATCH", "DELETE"):
        refused = empty.client.request(method, "/venues/import")
        assert_problem(refused, 405, "method_not_allowed")
        assert refused.headers["allow"] == "POST"
    assert empty.client.put("/venues/imports").headers["allow"] == "DELETE, GET, HEAD, PATCH"
    assert empty.client.post("/venues", json={"id": "imports", "name": "Imports"}).status_code == 201


@pytest.mark.parametrize(
    "body",
    [
        {"id": "a/b", "name": "x"},
        {"id": "..", "name": "x"},
        {"id": "", "name": "x"},
        {"id": "ü", "name": "x"},
        {"id": "a b", "name": "x"},
        {"id": "a\n", "name": "x"},
        {"id": "x" * 65, "name": "x"},
        {"id": 5, "name": "x"},
        {"id": "a", "name": ""},
        {"id": "a", "name": "x" * 201},
        {"id": "a", "name": None},
        {"id": "a"},
        {"name": "x"},
        [],
        "a",
        None,
    ],
    ids=str,
)
def test_venues_that_can_not_be(empty: Server, body: object) -> None:
    with empty.unchanged():
        assert_problem(empty.client.post("/venues", json=body), 422, "invalid_request")


def test_a_body_that_is_no_json(empty: Server) -> None:
    with empty.unchanged():
        for content in (b"{", b"\xff\xfe", b"[" * 100_000, b'{"id": "a", "name": "\\ud800"}'):
            answer = empty.client.post(
                "/venues", content=content, headers={"Content-Type": "application/json"}
            )
            assert answer.status_code in (400, 422)
            assert_problem(answer, answer.status_code)


def test_a_venue_twice_is_a_conflict(site: Server) -> None:
    with site.unchanged():
        answer = site.client.post("/venues", json={"id": "site", "name": "Again"})
        assert "PATCH" in assert_problem(answer, 409, "conflict")


def test_floors_come_change_and_go(site: Server) -> None:
    turned = [[0, -1, 0, 5], [1, 0, 0, 2], [0, 0, 1, 0], [0, 0, 0, 1]]
    assert put_floor(site, plan_from_world=turned, name="New", z_max_m=4).status_code == 200
    floor = site.client.get("/venues/site/floors/0").json()
    assert (floor["name"], floor["z_max_m"], floor["venue"]) == ("New", 4, "site")
    assert np.allclose(floor["plan_from_world"], turned)
    assert_problem(site.client.put("/venues/site/floors/-1", json=FLOOR), 422)
    site.client.put("/venues/site/floors/cellar", json={**FLOOR, "level": -1})
    assert [item["id"] for item in site.client.get("/venues/site/floors").json()] == ["cellar", "0"]
    assert site.client.delete("/venues/site/floors/cellar").status_code == 204
    assert_problem(site.client.get("/venues/site/floors/cellar"), 404, "not_found")
    assert_problem(site.client.put("/venues/none/floors/0", json=FLOOR), 404, "not_found")


def test_correspondences_are_fitted_and_their_residual_told(site: Server) -> None:
    pairs = [
        {"world": [0, 0, 0], "plan": [2, 1]},
        {"world": {"x": 10, "y": 0, "z": 0}, "plan": {"x": 2, "y": 11}},
        {"world": [0, 10], "plan": [-8, 1.3]},
    ]
    floor = put_floor(site, plan_from_world={"correspondences": pairs}).json()
    assert 0.01 < floor["plan_residual_m"] < 0.3
    assert floor["plan_scale"] == pytest.approx(1.0, abs=0.03)
    assert np.allclose(np.array(floor["plan_from_world"])[:2, :2], [[0, -1], [1, 0]], atol=0.05)


def test_plan_points_in_pixels_are_named(site: Server) -> None:
    world = [[0, 0, 0], [10, 0, 0], [10, 6, 0]]
    pixels = [[100, 700], [600, 700], [600, 400]]
    pairs = [{"world": a, "plan": b} for a, b in zip(world, pixels, strict=True)]
    with site.unchanged():
        sentence = assert_problem(
            put_floor(site, plan_from_world={"correspondences": pairs}), 422, "invalid_input"
        )
    assert "Mirrored they fit within 0.00 m at 50 plan units" in sentence
    assert "is y of the plan up?" in sentence
    assert "x = u / 50 and y = -v / 50" in sentence


def test_the_height_of_the_floor_shows_a_world_whose_y_is_up(site: Server) -> None:
    pairs = [{"world": [0, 1.5, 0], "plan": [2, 1]}, {"world": [10, 1.5, -6], "plan": [12, 7]}]
    given = {"plan_from_world": {"correspondences": pairs}, "z_min_m": 0}
    with site.unchanged():
        sentence = assert_problem(put_floor(site, **given, z_max_m=3), 422, "invalid_input")
    assert "y of the world is vertical" in sentence
    assert put_floor(site, **given, z_max_m=9).status_code == 200


IDENTITY = np.eye(4)
BAD_TRANSFORMS = {
    "singular": np.zeros((4, 4)).tolist(),
    "flat": np.diag([1.0, 1, 0, 1]).tolist(),
    "mirrored": np.diag([1.0, -1, 1, 1]).tolist(),
    "tilted": [[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]],
    "stretched": np.diag([1.0, 2, 1, 1]).tolist(),
    "projective": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 1, 1]],
    "3x3": np.eye(3).tolist(),
    "one row": [1, 0, 0, 0],
    "ragged": [[1, 0, 0, 0], [0, 1]],
    "NaN": [[float("nan")] * 4] * 4,
    "too large": [[10**400, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
    "words": "straight on",
    "a number": 1,
    "an empty object": {},
    "no pairs": {"correspondences": []},
    "one pair": {"correspondences": [{"world": [0, 0], "plan": [0, 0]}]},
    "pairs of nothing": {"correspondences": [{}, {}]},
    "the same point twice": {"correspondences": [{"world": [1, 1, 0], "plan": [2, 2]}] * 2},
    "one world point at two places": {
        "correspondences": [{"world": [1, 1, 0], "plan": [2, 2]}, {"world": [1, 1, 0], "plan": [3, 2]}]
    },
    "NaN pair": {
        "correspondences": [{"world": [float("nan"), 0], "plan": [0, 0]}, {"world": [1, 1], "plan": [1, 1]}]
    },
    "huge pair": {
        "correspondences": [{"world": [10**400, 0], "plan": [0, 0]}, {"world": [1, 1], "plan": [1, 1]}]
    },
    "words in a pair": {
        "correspondences": [{"world": ["a", 0], "plan": [0, 0]}, {"world": [1, 1], "plan": [1, 1]}]
    },
    "4 numbers": {
        "correspondences": [{"world": [0, 0, 0, 0], "plan": [0, 0]}, {"world": [1, 1], "plan": [1, 1]}]
    },
    "text": {"correspondences": "none"},
}


@pytest.mark.parametrize("name", BAD_TRANSFORMS)
def test_ways_to_the_plan_that_can_not_be(site: Server, name: str) -> None:
    with site.unchanged():
        answer = put_floor(site, plan_from_world=BAD_TRANSFORMS[name])
        assert_problem(answer, 422, "invalid_input")


@pytest.mark.parametrize(
    "changes",
    [
        {"z_min_m": 3, "z_max_m": 3},
        {"z_min_m": 5},
        {"z_min_m": float("nan")},
        {"z_max_m": float("inf")},
        {"level": 10**30},
        {"level": "ground"},
        {"name": ""},
    ],
    ids=str,
)
def test_floors_that_can_not_be(site: Server, changes: dict[str, object]) -> None:
    with site.unchanged():
        assert_problem(put_floor(site, **changes), 422, "invalid_request")


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_a_plan_image_comes_back_as_it_was(site: Server, suffix: str) -> None:
    image = encode(np.full((60, 80, 3), 200, np.uint8), suffix)
    answer = site.client.put("/venues/site/floors/0/plan", data=PLAN_FORM, files={"image": image})
    assert answer.status_code == 200, answer.text
    plan = answer.json()["plan"]
    assert (plan["width_px"], plan["height_px"], plan["meters_per_pixel"]) == (80, 60, 0.05)
    assert plan["origin_px"] == [10, 50]
    got = site.client.get("/venues/site/floors/0/plan")
    assert got.content == image
    assert got.headers["content-type"] == {".png": "image/png", ".jpg": "image/jpeg"}[suffix]
    # Changing the floor keeps its plan.
    assert put_floor(site, name="Renamed").json()["plan"] == plan


def test_a_floor_without_a_plan_has_none(site: Server) -> None:
    assert_problem(site.client.get("/venues/site/floors/0/plan"), 404, "not_found")


WEBP = encode(np.full((60, 80, 3), 200, np.uint8), ".webp", [cv2.IMWRITE_WEBP_QUALITY, 90])
BAD_PLANS = {
    "text": (b"not an image", {}, (415, 422)),
    "empty": (b"", {}, (422,)),
    "cut short": (PLAN[:50], {}, (422,)),
    "webp": (WEBP, {}, (415, 422)),
    "svg": (b"<svg/>", {}, (415, 422)),
    "zero scale": (PLAN, {"meters_per_pixel": "0"}, (422,)),
    "negative scale": (PLAN, {"meters_per_pixel": "-1"}, (422,)),
    "NaN scale": (PLAN, {"meters_per_pixel": "nan"}, (422,)),
    "scale in words": (PLAN, {"meters_per_pixel": "small"}, (422,)),
    "origin with one number": (PLAN, {"origin_px": "5"}, (422,)),
    "origin with three": (PLAN, {"origin_px": "[1,2,3]"}, (422,)),
    "NaN origin": (PLAN, {"origin_px": "nan,5"}, (422,)),
    "origin in words": (PLAN, {"origin_px": "top,left"}, (422,)),
    "endless origin": (PLAN, {"origin_px": f"[1{'0' * 400},5]"}, (422,)),
    "broken origin": (PLAN, {"origin_px": "[1,"}, (422,)),
}


@pytest.mark.parametrize("name", BAD_PLANS)
def test_plans_that_can_not_be(site: Server, name: str) -> None:
    image, changes, statuses = BAD_PLANS[name]
    with site.unchanged():
        answer = site.client.put(
            "/venues/site/floors/0/plan", data={**PLAN_FORM, **changes}, files={"image": image}
        )
        assert answer.status_code in statuses
        assert_problem(answer, answer.status_code)


def test_a_plan_for_no_floor(site: Server) -> None:
    with site.unchanged():
        answer = site.client.put("/venues/site/floors/9/plan", data=PLAN_FORM, files={"image": PLAN})
        assert_problem(answer, 404, "not_found")
