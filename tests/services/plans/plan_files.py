"""Floor plans in every format, made here: a square room of 10 x 5 m with a black outline."""

from __future__ import annotations

import io
import zlib
from pathlib import Path

import ezdxf
import numpy as np
from ezdxf.document import Drawing
from PIL import Image

INCH_MM = 25.4


def pdf(
    *contents: bytes, width_pt: float = 283.465, height_pt: float = 141.732, filters: bytes = b""
) -> bytes:
    """Return a PDF with a page for each content stream; the default page is 100 x 50 mm."""
    count = len(contents)
    kids = b" ".join(b"%d 0 R" % (3 + 2 * k) for k in range(count))
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R >>",
        b"<< /Type /Pages /Kids [%s] /Count %d >>" % (kids, count),
    ]
    for k, content in enumerate(contents):
        box = f"/MediaBox [0 0 {width_pt} {height_pt}]".encode()
        objects.append(b"<< /Type /Page /Parent 2 0 R %s /Contents %d 0 R >>" % (box, 4 + 2 * k))
        objects.append(b"<< /Length %d %s >>\nstream\n%s\nendstream" % (len(content), filters, content))
    made, offsets = b"%PDF-1.4\n", []
    for number, one in enumerate(objects, 1):
        offsets.append(len(made))
        made += b"%d 0 obj\n%s\nendobj\n" % (number, one)
    start = len(made)
    made += b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1)
    made += b"".join(b"%010d 00000 n \n" % offset for offset in offsets)
    return made + b"trailer << /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (len(objects) + 1, start)


# The room at 1:100 is 100 x 50 mm: it fills the page but for a margin of 5 mm (14.17 points).
ROOM = b"2 w 14.17 14.17 255.12 113.39 re S"


def packed_pdf(content: bytes) -> bytes:
    """Return a PDF of one page whose content is compressed."""
    return pdf(zlib.compress(content, 9), filters=b"/Filter /FlateDecode")


def svg(inside: str = "", size: str = 'width="100mm" height="50mm"', before: str = "") -> bytes:
    """Return an SVG of 100 x 50 mm with the room in it."""
    links = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
    room = '<rect x="5" y="5" width="90" height="40" fill="none" stroke="black" stroke-width="1"/>'
    return f'{before}<svg {links} {size} viewBox="0 0 100 50">{room}{inside}</svg>'.encode()


def dxf(folder: Path, unit: int = 4, document: Drawing | None = None) -> bytes:
    """Return a DXF: the room as a polyline from (2, 1) m, a round pillar, and a door in a block, in millimetres."""
    made = document or ezdxf.new()
    made.units = unit
    if document is None:
        space = made.modelspace()
        corners = [(2000, 1000), (12000, 1000), (12000, 6000), (2000, 6000)]
        space.add_lwpolyline(corners, close=True)
        space.add_circle((7000, 3500), 200)
        made.blocks.new("DOOR").add_line((0, 0), (900, 0))
        space.add_blockref("DOOR", (2000, 2000), dxfattribs={"rotation": 90})
        space.add_text("no text is drawn")
    path = folder / "room.dxf"
    made.saveas(path)
    return path.read_bytes()


def picture(kind: str, mode: str = "1", size: tuple[int, int] = (400, 200), pages: int = 1) -> bytes:
    """Return a white picture with a black column in its middle, and with its page number as width."""
    images = []
    for page in range(1, pages + 1):
        image = Image.new("L", size, 255)
        image.paste(0, (size[0] // 2, 0, size[0] // 2 + page, size[1]))
        images.append(image.convert(mode))
    buffer = io.BytesIO()
    more = {"save_all": True, "append_images": images[1:]} if pages > 1 else {}
    images[0].save(buffer, format=kind, **more)
    return buffer.getvalue()


def dark_columns(png: bytes) -> tuple[int, int]:
    """Return the first and the last column of a picture with something dark in it."""
    grey = np.asarray(Image.open(io.BytesIO(png)).convert("L"))
    columns = np.flatnonzero((grey < 200).any(axis=0))
    return int(columns[0]), int(columns[-1])
