"""GET .../plan.svg: the plan with its features and a route, whatever its names hold."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest

from tests.plans import add_plans, area, collection, landmark, put_features
from tests.server import Server, assert_problem

SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture
def site(empty: Server) -> Server:
    """A server with a venue of two floors with features."""
    add_plans(empty)
    return empty


def drawing(server: Server, floor: str = "ground", **query: Any) -> ElementTree.Element:
    answer = server.client.get(f"/venues/site/floors/{floor}/plan.svg", params=query)
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"].startswith("image/svg+xml")
    assert "default-src 'none'" in answer.headers["content-security-policy"]
    return ElementTree.fromstring(answer.text)


def classes(root: ElementTree.Element) -> list[str | None]:
    return [element.get("class") for element in root.iter()]


def test_features_are_drawn(site: Server) -> None:
    found = classes(drawing(site))
    assert [found.count(kind) for kind in ("area", "link", "link way", "landmark", "poi", "route")] == [
        3,
        3,
        2,
        5,
        1,
        0,
    ]


def test_a_route_is_drawn_on_each_of_its_floors(site: Server) -> None:
    query = {"from": "desk", "to": "shelf"}
    ground, upper = drawing(site, **query), drawing(site, "upper", **query)
    line = next(e for e in ground.iter() if e.get("class") == "route")
    assert line.get("points") == "8.000,-5.000 8.000,-1.000 18.000,-1.000 14.000,-1.000"
    assert ("start" in classes(ground), "end" in classes(ground)) == (True, False)
    assert ("start" in classes(upper), "end" in classes(upper)) == (False, True)


def test_the_plan_image_lies_under_it(site: Server) -> None:
    data = cv2.imencode(".png", np.full((60, 80, 3), 200, np.uint8))[1].tobytes()
    form = {"meters_per_pixel": "0.5", "origin_px": "9.5,49.5"}
    answer = site.client.put("/venues/site/floors/ground/plan", data=form, files={"image": ("p.png", data)})
    assert answer.status_code == 200
    image = drawing(site).find(f"{SVG}image")
    assert image is not None
    assert [float(image.get(key, "nan")) for key in ("x", "y", "width", "height")] == [-5, -25, 40, 30]


def test_names_can_not_become_markup(site: Server) -> None:
    evil = '"><script>alert(1)</script>'
    put_features(site, "ground", collection(area(evil, 0, 0, 1, 1, name=evil), landmark("m", 0, 0, evil)))
    root = drawing(site)
    assert not list(root.iter(f"{SVG}script"))
    assert evil in [element.text for element in root.iter()]


def test_a_floor_without_features(site: Server) -> None:
    put_features(site, "ground", collection())
    assert drawing(site).get("viewBox") == "0.00 -10.00 10.00 10.00"


@pytest.mark.parametrize(
    ("floor", "query", "status", "code"),
    [
        ("cellar", {}, 404, "not_found"),
        ("ground", {"from": "desk"}, 422, "invalid_input"),
        ("ground", {"from": "desk", "to": "moon"}, 404, "not_found"),
    ],
)
def test_drawings_that_can_not_be(
    site: Server, floor: str, query: dict[str, str], status: int, code: str
) -> None:
    assert_problem(site.client.get(f"/venues/site/floors/{floor}/plan.svg", params=query), status, code)
