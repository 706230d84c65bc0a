"""Plans in PDF, SVG, DXF, TIFF and of many pixels over HTTP: their scale, and files that are hostile."""

from __future__ import annotations

import base64
import gzip
import re
from pathlib import Path
from typing import Any

import pytest

from app.settings import Settings
from tests.server import Server, assert_problem
from tests.services.plans.plan_files import ROOM, dark_columns, dxf, packed_pdf, pdf, picture, svg

FLOOR = {"name": "Ground", "level": 0, "z_min_m": -0.5, "z_max_m": 3.0}


@pytest.fixture
def site(empty: Server) -> Server:
    """A server with the venue `site` and its floor `0`."""
    empty.add_venue("site")
    assert empty.client.put("/venues/site/floors/0", json=FLOOR).status_code == 200
    return empty


def send(site: Server, data: bytes, **fields: str) -> Any:
    return site.client.put("/venues/site/floors/0/plan", data=fields, files={"image": data})


def put_plan(site: Server, data: bytes, **fields: str) -> dict[str, Any]:
    """Put a plan and return what the floor says of it."""
    answer = send(site, data, **fields)
    assert answer.status_code == 200, answer.text
    plan: dict[str, Any] = answer.json()["plan"]
    assert plan["media_type"] == "image/png"
    return plan


def shown(site: Server) -> bytes:
    got = site.client.get("/venues/site/floors/0/plan")
    assert got.headers["content-type"] == "image/png"
    return bytes(got.content)


@pytest.mark.parametrize("data", [pdf(ROOM), packed_pdf(ROOM), svg()], ids=["pdf", "packed pdf", "svg"])
def test_a_drawing_has_the_scale_of_its_paper(site: Server, data: bytes) -> None:
    plan = put_plan(site, data, scale="1:100", dpi="254")
    assert plan["meters_per_pixel"] == pytest.approx(0.01)
    assert (plan["width_px"], plan["height_px"]) == pytest.approx((1000, 500), abs=1)
    assert plan["origin_px"] == pytest.approx([0, plan["height_px"] - 1])
    # The room's outer edges are 9 m apart, 0.5 m from the paper's edge.
    first, last = dark_columns(shown(site))
    assert first == pytest.approx(46, abs=5)
    assert (last - first) * plan["meters_per_pixel"] == pytest.approx(9.0, abs=0.12)


def test_without_dpi_a_drawing_has_150(site: Server) -> None:
    plan = put_plan(site, pdf(ROOM), scale="50", origin_px="10,20")
    assert plan["meters_per_pixel"] == pytest.approx(50 * 0.0254 / 150)
    assert plan["origin_px"] == [10, 20]
    assert plan["width_px"] == pytest.approx(100 / 25.4 * 150, abs=1)


def test_a_page_is_chosen(site: Server) -> None:
    pages = pdf(b"", b"2 w 141 0 m 141 141 l S")
    put_plan(site, pages, scale="1:100", page="2")
    assert dark_columns(shown(site))[0] == pytest.approx(293, abs=3)
    with site.unchanged():
        problem = assert_problem(send(site, pages, scale="1:100", page="3"), 422, "invalid_input")
    assert "page is 3, but the file has 2" in problem


def test_a_dxf_is_drawn_in_metres_from_its_own_origin(site: Server, tmp_path: Path) -> None:
    plan = put_plan(site, dxf(tmp_path), meters_per_pixel="0.02")
    assert plan["meters_per_pixel"] == 0.02
    assert (plan["width_px"], plan["height_px"]) == (520, 270)
    u, v = plan["origin_px"]
    # The room's corner lies at (2, 1) m of the drawing.
    assert (u + 2 / 0.02, v - 1 / 0.02) == pytest.approx((10, 259))
    assert dark_columns(shown(site)) == pytest.approx((10, 510), abs=1)
    own = put_plan(site, dxf(tmp_path))
    assert max(own["width_px"], own["height_px"]) == 4020


def test_a_dxf_without_units_needs_them(site: Server, tmp_path: Path) -> None:
    data = dxf(tmp_path, unit=0)
    with site.unchanged():
        problem = assert_problem(send(site, data), 422, "invalid_input")
    assert "give units: one of mm, cm, m, in, ft" in problem
    assert put_plan(site, data, units="mm", meters_per_pixel="0.02")["width_px"] == 520


def test_tiff_of_one_bit_and_of_several_pages(site: Server) -> None:
    plan = put_plan(site, picture("TIFF", pages=3), meters_per_pixel="0.05", page="3")
    assert (plan["width_px"], plan["height_px"]) == (400, 200)
    assert dark_columns(shown(site)) == (200, 202)
    scanned = put_plan(site, picture("TIFF", mode="L"), scale="1:200", dpi="300")
    assert scanned["meters_per_pixel"] == pytest.approx(200 * 0.0254 / 300)


def test_a_png_of_one_bit_stays_as_it_is(site: Server) -> None:
    data = picture("PNG", mode="1")
    put_plan(site, data, meters_per_pixel="0.05", origin_px="0,0")
    assert shown(site) == data


def test_a_plan_larger_than_what_is_decoded_is_reduced(empty: Server) -> None:
    site = empty
    site.add_venue("site")
    site.client.put("/venues/site/floors/0", json=FLOOR)
    side = 9_000
    assert side * side > Settings(_env_file=None).max_image_pixels
    plan = put_plan(site, picture("PNG", size=(side, side)), meters_per_pixel="0.004", origin_px="4500,4500")
    assert (plan["width_px"], plan["height_px"]) == (side // 2, side // 2)
    assert plan["meters_per_pixel"] == pytest.approx(0.008)
    # Between the middles of two pixels, as the middle of four.
    assert plan["origin_px"] == [2249.75, 2249.75]
    assert dark_columns(shown(site))[0] == pytest.approx(2250, abs=1)


def test_nothing_says_how_large_a_pixel_is(site: Server) -> None:
    for data in (pdf(ROOM), picture("PNG")):
        with site.unchanged():
            problem = assert_problem(send(site, data, origin_px="0,0"), 422, "invalid_input")
        assert "Give meters_per_pixel, or scale" in problem


@pytest.mark.parametrize("scale", ["", "a", "1:0", "2:100", "0.5", "1:1e9", "1:100:1"])
def test_scales_that_are_none(site: Server, scale: str) -> None:
    with site.unchanged():
        assert_problem(send(site, pdf(ROOM), scale=scale), 422)


@pytest.mark.parametrize(
    ("kind", "fields", "words"),
    [
        ("dxf", {"scale": "1:100"}, "leave scale out"),
        ("dxf", {"meters_per_pixel": "0.0001"}, "give a larger meters_per_pixel"),
        ("dxf", {"page": "2"}, "page is 2, but the file has 1"),
        ("png", {"meters_per_pixel": "0.05", "page": "2"}, "page is 2, but the file has 1"),
        ("png", {"meters_per_pixel": "50"}, "1 divided by it"),
        ("png", {"meters_per_pixel": "9"}, None),
        ("pdf", {"scale": "1:100", "meters_per_pixel": "0.5"}, "scale says 0.01693 m for a pixel"),
        ("pdf", {"scale": "1:100", "meters_per_pixel": "0.01693"}, None),
        ("user unit", {"scale": "1:100"}, "UserUnit"),
        ("user unit", {"meters_per_pixel": "0.02"}, None),
    ],
)
def test_what_is_said_of_a_plan_fits_its_file(
    site: Server, tmp_path: Path, kind: str, fields: dict[str, str], words: str | None
) -> None:
    files = {
        "dxf": dxf(tmp_path),
        "png": picture("PNG"),
        "pdf": pdf(ROOM),
        "user unit": pdf(ROOM).replace(b"/Type /Page ", b"/UserUnit 10 /Type /Page "),
    }
    if words is None:
        put_plan(site, files[kind], **fields)
        return
    with site.unchanged():
        answer = send(site, files[kind], **fields)
        assert words in assert_problem(answer, answer.status_code)
    assert answer.status_code in (413, 422)


def test_a_plan_longer_than_any_venue_is_refused(site: Server) -> None:
    with site.unchanged():
        answer = send(site, picture("PNG", size=(4000, 300)), meters_per_pixel="9")
        assert "36 km long" in assert_problem(answer, 422, "invalid_input")


@pytest.mark.parametrize(
    ("data", "name"),
    [
        (b"AC1032" + bytes(100), "DWG (save it as DXF)"),
        (b"ISO-10303-21;\nHEADER;", "IFC or STEP"),
        (b"%!PS-Adobe-3.0 EPSF-3.0", "PostScript"),
        (gzip.compress(svg()), "gzip (unpack an SVGZ to SVG)"),
        (picture("WEBP", mode="L"), "WebP"),
        (picture("GIF"), "a GIF image"),
        (picture("BMP"), "a BMP image"),
        (base64.b64encode(picture("PNG")), "a picture as base64 text"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_files_that_are_no_plan_are_named(site: Server, data: bytes, name: str) -> None:
    with site.unchanged():
        answer = send(site, data, meters_per_pixel="0.05")
        assert f"not {name}" in assert_problem(answer, 422, "invalid_input")


def test_an_svg_may_begin_with_a_long_comment(site: Server) -> None:
    before = f'<?xml version="1.0"?><!-- {"x" * 10_000} -->'
    assert put_plan(site, svg(before=before), scale="1:100")["width_px"] == pytest.approx(591, abs=1)


@pytest.mark.parametrize("origin", ["1e300,0", "0,nan", "0,-inf"])
def test_an_origin_that_is_nowhere_is_refused(site: Server, origin: str) -> None:
    with site.unchanged():
        answer = send(site, picture("PNG"), meters_per_pixel="0.05", origin_px=origin)
        assert "origin_px must be two numbers" in assert_problem(answer, 422, "invalid_input")


def test_a_dxf_may_begin_with_a_byte_order_mark(site: Server, tmp_path: Path) -> None:
    assert put_plan(site, b"\xef\xbb\xbf" + dxf(tmp_path))["width_px"] > 1000


ENTITIES = '<!DOCTYPE svg [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
HOSTILE = {
    "a huge page": (pdf(ROOM, width_pt=1e6, height_pt=1e6), "pixels, the limit is 400,000,000"),
    "a PDF that is cut off": (pdf(ROOM)[:200], r"PDF can't be read: [^.]+\.$"),
    "a PDF of nothing": (b"%PDF-1.7\n", "PDF can't be read"),
    "a picture outside": (svg('<image href="file:///etc/hostname" width="9" height="9"/>'), "refers to"),
    "a picture on the net": (
        svg('<image xlink:href="http://127.0.0.1:9/a.png" width="9" height="9"/>'),
        "refers to",
    ),
    "a relative picture": (svg('<image href="../secret.png" width="9" height="9"/>'), "refers to"),
    "an SVG in the SVG": (
        svg('<image href="data:image/svg+xml,&lt;svg/&gt;" width="9" height="9"/>'),
        "refers to",
    ),
    "a style from outside": (svg("<style>@import url(http://127.0.0.1:9/a.css);</style>"), "refers to"),
    "a fill from outside": (svg('<rect fill="url(http://127.0.0.1:9/a.svg#x)"/>'), "refers to"),
    "entities": (svg("<text>&b;</text>", before=ENTITIES), "entities"),
    "a file by an entity": (
        svg("<text>&f;</text>", before='<!DOCTYPE svg [<!ENTITY f SYSTEM "file:///etc/hostname">]>'),
        "entities",
    ),
    "a huge SVG": (svg(size='width="100000cm" height="100000cm"'), "pixels, the limit"),
    "an SVG without a size": (b"<svg xmlns='http://www.w3.org/2000/svg'/>", "width and height"),
    "an SVG that is no XML": (svg()[:-3], "not valid XML"),
    "a DXF that is cut off": (b"  0\nSECTION\n  2\nENTITIES\n  0\nLINE\n", "DXF"),
    "a TIFF that is cut off": (picture("TIFF")[:60], "damaged|no PNG|can't be"),
    "a word processor's file": (b"PK\x03\x04" + bytes(100), "PNG, JPEG, TIFF, PDF, SVG or DXF"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_and_damaged_plans_are_refused_with_a_reason(site: Server, name: str) -> None:
    data, hint = HOSTILE[name]
    with site.unchanged():
        answer = send(site, data, scale="1:100", dpi="150", units="m")
    assert answer.status_code in (413, 415, 422), answer.text
    assert_problem(answer, answer.status_code)
    assert re.search(hint, answer.json()["detail"]), answer.json()["detail"]
