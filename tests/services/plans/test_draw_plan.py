"""Drawings that would never end: given up within the time and memory that they may take."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import ezdxf
import pytest

from app.errors import InvalidImageError
from app.importers.plan_images.order import DrawOrder, kind_of
from app.services.plans.draw_plan import draw_plan
from tests.services.plans.plan_files import ROOM, dxf, packed_pdf, pdf, picture, svg


def nested_uses() -> bytes:
    """Return an SVG of a few lines that draws 10^12 rectangles."""
    groups = ['<g id="g0"><rect width="1" height="1"/></g>']
    for k in range(1, 13):
        groups.append(f'<g id="g{k}">' + f'<use xlink:href="#g{k - 1}"/>' * 10 + "</g>")
    return svg(f"<defs>{''.join(groups)}</defs><use xlink:href='#g12'/>")


def nested_blocks(folder: Path) -> bytes:
    """Return a DXF of blocks in blocks that draws 10^9 lines."""
    made = ezdxf.new()
    made.blocks.new("B0").add_line((0, 0), (1, 0))
    for k in range(1, 10):
        block = made.blocks.new(f"B{k}")
        for row in range(10):
            block.add_blockref(f"B{k - 1}", (row, 0))
    made.modelspace().add_blockref("B9", (0, 0))
    return dxf(folder, document=made)


BOMBS: dict[str, Callable[[Path], bytes]] = {
    "SVG": lambda _: nested_uses(),
    "DXF": nested_blocks,
    "PDF": lambda _: packed_pdf(b"0 0 m 283 141 l S\n" * 20_000_000),
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_small_file_that_draws_without_end_is_given_up(tmp_path: Path, name: str) -> None:
    data = BOMBS[name](tmp_path)
    assert len(data) < 2_000_000
    order = DrawOrder(kind=kind_of(data) or "", units="m", timeout_s=6.0)
    with pytest.raises(InvalidImageError):
        draw_plan(data, order, tmp_path / "scratch")
    assert not any((tmp_path / "scratch").iterdir())


def with_circle(folder: Path, height: str = "7.75", radius: str = "1.625") -> bytes:
    """Return a DXF of a line and a circle, whose numbers are written as given."""
    made = ezdxf.new()
    made.modelspace().add_line((0, 0), (5, 5))
    made.modelspace().add_circle((1, 1, 7.75), 1.625)
    data = dxf(folder, document=made)
    assert (data.count(b"\n7.75\n"), data.count(b"\n1.625\n")) == (1, 1)
    return data.replace(b"\n7.75\n", f"\n{height}\n".encode()).replace(b"\n1.625\n", f"\n{radius}\n".encode())


def test_a_cut_dxf_is_refused_and_padding_is_not(tmp_path: Path) -> None:
    data, order = with_circle(tmp_path), DrawOrder(kind="dxf", units="m", meters_per_pixel=0.1)
    whole = draw_plan(data + b"\r\n\x1a", order, tmp_path / "scratch")
    assert whole.drawn.width_px > 50
    for share in (0.5, 0.95):
        with pytest.raises(InvalidImageError, match="cut short, it has no EOF"):
            draw_plan(data[: int(share * len(data))], order, tmp_path / "scratch")


def test_numbers_that_are_none_in_a_dxf_take_no_time(tmp_path: Path) -> None:
    order = DrawOrder(kind="dxf", units="m", meters_per_pixel=0.1, timeout_s=20.0)
    drawn = draw_plan(with_circle(tmp_path, height="nan"), order, tmp_path / "scratch")
    assert drawn.drawn.width_px > 50
    with pytest.raises(InvalidImageError, match=r"a coordinate of .*e\+20: it is damaged"):
        draw_plan(with_circle(tmp_path, radius="1e20"), order, tmp_path / "scratch")


@pytest.mark.parametrize(
    ("data", "kind"),
    [
        (pdf(ROOM), "pdf"),
        (b"junk before" + pdf(ROOM), "pdf"),
        (svg(before="<?xml version='1.0'?>\n<!-- made by hand -->"), "svg"),
        (picture("TIFF"), "tiff"),
        (picture("PNG"), "png"),
        (picture("JPEG", mode="L"), "jpeg"),
        (b"  0\r\nSECTION\r\n", "dxf"),
        (b"999\ncomment\n  0\nSECTION\n", "dxf"),
        (b"<html></html>", None),
        (b"<!--" * 4000, None),
        (b"AC1032", None),
        (b"", None),
    ],
)
def test_kinds_are_told_by_their_first_bytes(data: bytes, kind: str | None) -> None:
    assert kind_of(data) == kind
