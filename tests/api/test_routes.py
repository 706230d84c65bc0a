"""GET /venues/{venue}/route: the way, its steps in words, and why there is none."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import httpx
import pytest

from tests.plans import UPPER, add_plans, collection, landmark, link, put_features
from tests.server import Server, assert_problem, running


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server with a venue of two floors with features, and one without any."""
    with running(tmp_path_factory.mktemp("site"), run_worker=False) as server:
        add_plans(server)
        server.add_venue("bare")
        yield server


def ask(
    server: Server, venue: str = "site", headers: dict[str, str] | None = None, **query: Any
) -> httpx.Response:
    return server.client.get(f"/venues/{venue}/route", params=query, headers=headers)


def route(server: Server, **query: Any) -> dict[str, Any]:
    answer = ask(server, **query)
    assert answer.status_code == 200, answer.text
    return dict(answer.json())


def test_a_route_over_floors(site: Server) -> None:
    found = route(site, **{"from": "desk", "to": "shelf"})
    assert found["distance_m"] == pytest.approx(4 + 10 + 10 + 12 + 4)
    assert found["landmarks"] == ["desk", "office-door", "stairs", "stairs", "shelf"]
    assert found["path"][0] == {"floor": "ground", "x": 8, "y": 5}
    assert found["path"][-1] == {"floor": "upper", "x": 2, "y": 5}
    steps = found["steps"]
    assert [step["turn"] for step in steps] == ["depart", "left", "up", "straight", "right", "arrive"]
    assert [step["landmark"] for step in steps] == [
        "desk",
        "office-door",
        "stairs",
        "stairs",
        "shelf",
        "shelf",
    ]
    assert [step["distance_m"] for step in steps] == [4, 10, 10, 12, 4, 0]
    assert (steps[2]["mode"], steps[2]["floor"], steps[2]["to_floor"]) == ("stairs", "ground", "upper")
    assert steps[2]["instruction"] == "Take the stairs up to Upper floor."


@pytest.mark.parametrize(
    "query",
    [
        {"avoid": "stairs"},
        {"avoid": ["stairs", "escalator"]},
        {"avoid": " Stairs,escalator,"},
        {"avoid": "staircase"},
        {"accessible": "true"},
    ],
)
def test_a_route_by_lift(site: Server, query: dict[str, Any]) -> None:
    found = route(site, **{"from": "desk", "to": "shelf", **query})
    assert {step["mode"] for step in found["steps"]} == {"walk", "lift"}


def test_a_route_from_a_point_with_a_heading(site: Server) -> None:
    found = route(site, **{"from": "ground:5,1", "to": "upper:10,1.5", "heading_deg": 180})
    assert found["steps"][0]["turn"] == "u_turn"
    assert found["steps"][0]["instruction"] == "Turn around and walk 13 m towards Stairs, past Office-Door."
    assert found["distance_m"] == pytest.approx(13 + 10 + 4 + 0.5)


def test_the_language_is_chosen_or_negotiated(site: Server) -> None:
    query = {"from": "desk", "to": "shelf"}
    german = route(site, **query, language="de")
    assert german["language"] == "de"
    assert german["steps"][0]["instruction"] == "Gehen Sie 4 m in Richtung Office-Door."
    by_header = ask(site, headers={"Accept-Language": "de-CH, en;q=0.5"}, **query).json()
    assert by_header == german
    assert ask(site, headers={"Accept-Language": "tlh, ;;q=x"}, **query).json()["language"] == "en"
    assert "'de', 'en'" in assert_problem(ask(site, **query, language="fr"), 422, "invalid_input")


def test_no_route(site: Server) -> None:
    blocked = ask(site, **{"from": "desk", "to": "shelf", "avoid": "stairs,lift"})
    assert "only floor 'ground' can be reached" in assert_problem(blocked, 404, "no_route")


def test_other_features_change_the_routes_at_once(site: Server) -> None:
    query = {"from": "desk", "to": "shelf"}
    before = route(site, **query)
    put_features(site, "upper", collection(*UPPER["features"][:-1]))
    assert "'ground:stairs-up'" not in assert_problem(ask(site, **query), 404, "no_route")
    put_features(site, "upper", UPPER)
    assert route(site, **query) == before


@pytest.mark.parametrize(
    ("query", "status", "code"),
    [
        ({"to": "desk"}, 422, "invalid_request"),
        ({"from": "desk"}, 422, "invalid_request"),
        ({"from": "", "to": "desk"}, 422, "invalid_input"),
        ({"from": "moon", "to": "desk"}, 404, "not_found"),
        ({"from": "desk", "to": "cellar:1,2"}, 404, "not_found"),
        ({"from": "desk", "to": "stairs"}, 422, "invalid_input"),
        ({"from": "ground:500,1", "to": "desk"}, 422, "off_network"),
        ({"from": "ground:1e99,1", "to": "desk"}, 422, "invalid_input"),
        ({"from": "desk", "to": "shelf", "avoid": "dogs"}, 422, "invalid_input"),
        ({"from": "desk", "to": "shelf", "avoid": ["stairs"] * 30}, 422, "invalid_request"),
        ({"from": "desk", "to": "shelf", "accessible": "perhaps"}, 422, "invalid_request"),
        ({"from": "desk", "to": "shelf", "heading_deg": "nan"}, 422, "invalid_request"),
        ({"from": "desk", "to": "shelf", "heading_deg": "1e9"}, 422, "invalid_request"),
        ({"from": "x" * 5000, "to": "shelf"}, 422, "invalid_request"),
        ({"from": "desk\x00", "to": "\ud7ff"}, 404, "not_found"),
    ],
    ids=str,
)
def test_queries_that_have_no_answer(site: Server, query: dict[str, Any], status: int, code: str) -> None:
    with site.unchanged():
        assert_problem(ask(site, **query), status, code)


def test_venues_without_floors_or_unknown(site: Server) -> None:
    query = {"from": "a", "to": "b"}
    assert_problem(ask(site, venue="bare", **query), 404, "not_found")
    assert_problem(ask(site, venue="none", **query), 404, "not_found")


def test_a_tangle_of_links_is_refused(site: Server) -> None:
    up_and_down = [(k % 2 * 90.0, k / 50) for k in range(2500)]
    to_and_fro = [(y, x) for x, y in up_and_down]
    ends = [landmark("a", 2, 1), landmark("b", *up_and_down[-1]), landmark("c", *to_and_fro[-1])]
    tangle = collection(*ends, link((2, 1), *up_and_down), link((2, 1), *to_and_fro))
    with site.unchanged():
        sentence = assert_problem(put_features(site, "ground", tangle), 422, "invalid_input")
    assert "more than 100,000 times" in sentence


def test_routes_need_a_key(tmp_path: Any) -> None:
    with running(tmp_path, run_worker=False, admin_key="secret") as server:
        assert_problem(ask(server, **{"from": "a", "to": "b"}), 401, "unauthenticated")
