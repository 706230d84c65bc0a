"""Plans of many pixels: their tiles over HTTP, what there is none of, and files of venues with hostile tiles."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from PIL import Image

from app.errors import InvalidInputError
from app.importers.plan_images.tiles import MAGIC, TileGrid, check_tiles, read_tile, write_tiles
from tests.server import Server, assert_problem
from tests.services.plans.plan_files import picture

FLOOR = {"name": "Ground", "level": 0, "z_min_m": -0.5, "z_max_m": 3.0}
PLAN = "/venues/site/floors/0/plan"
# Just above the number of pixels from which a plan has tiles.
WIDTH_PX = 5_000
HEIGHT_PX = 3_300


@pytest.fixture
def site(empty: Server) -> Server:
    """A server with the venue `site`, whose floor `0` has a plan of a black column in the middle."""
    empty.add_venue("site")
    assert empty.client.put("/venues/site/floors/0", json=FLOOR).status_code == 200
    return empty


def put_plan(site: Server, data: bytes) -> dict[str, Any]:
    """Put a plan and return what the floor says of it."""
    fields = {"meters_per_pixel": "0.01", "origin_px": "0,0"}
    answer = site.client.put(PLAN, data=fields, files={"image": data})
    assert answer.status_code == 200, answer.text
    plan: dict[str, Any] = answer.json()["plan"]
    return plan


def grey(png: bytes) -> Any:
    return np.asarray(Image.open(io.BytesIO(png)).convert("L"))


def test_a_plan_of_many_pixels_has_tiles(site: Server) -> None:
    large = picture("TIFF", size=(WIDTH_PX, HEIGHT_PX))
    plan = put_plan(site, large)
    assert plan["tiles"] == {
        "width_px": WIDTH_PX, "height_px": HEIGHT_PX, "tile_px": 512, "max_zoom": 4, "reduced_by": 1,
    }  # fmt: skip
    # The black column is pixel 2500: in tile 4 at the finest zoom, 452 from its left.
    finest = site.client.get(f"{PLAN}/tiles/4/4/2.png")
    assert finest.headers["content-type"] == "image/png"
    assert finest.headers["etag"] != site.client.get(f"{PLAN}/tiles/4/5/2.png").headers["etag"]
    assert np.argwhere(grey(finest.content)[0] < 128).ravel().tolist() == [2500 - 4 * 512]
    assert grey(site.client.get(f"{PLAN}/tiles/4/9/6.png").content).shape == (3300 - 6 * 512, 5000 - 9 * 512)
    whole = grey(site.client.get(f"{PLAN}/tiles/0/0/0.png").content)
    assert whole.shape == (-(-HEIGHT_PX // 16), -(-WIDTH_PX // 16))
    assert np.argmin(whole[0]) == 2500 // 16
    tag = {"If-None-Match": finest.headers["etag"]}
    assert site.client.get(f"{PLAN}/tiles/4/4/2.png", headers=tag).status_code == 304
    # The picture that is stored, sent again for another scale, keeps them; another plan doesn't.
    shown = site.client.get(PLAN).content
    assert put_plan(site, shown)["tiles"] == plan["tiles"]
    assert put_plan(site, picture("PNG"))["tiles"] is None


def test_what_has_no_tiles_says_so(site: Server) -> None:
    assert "has no plan" in assert_problem(site.client.get(f"{PLAN}/tiles/0/0/0.png"), 404, "not_found")
    put_plan(site, picture("PNG"))
    assert "get its plan" in assert_problem(site.client.get(f"{PLAN}/tiles/0/0/0.png"), 404, "not_found")
    put_plan(site, picture("PNG", size=(WIDTH_PX, HEIGHT_PX)))
    for name, sentence in (("5/0/0", "zooms 0 to 4"), ("4/10/0", "10 x 7 tiles"), ("0/0/1", "1 x 1 tiles")):
        problem = assert_problem(site.client.get(f"{PLAN}/tiles/{name}.png"), 404, "not_found")
        assert sentence in problem
    for name in ("-1/0/0", "0/x/0", "0/0/1e3", "0/0/99999999999999999999"):
        assert_problem(site.client.get(f"{PLAN}/tiles/{name}.png"), 422)


def test_a_venues_file_takes_the_tiles_along(site: Server) -> None:
    plan = put_plan(site, picture("PNG", size=(WIDTH_PX, HEIGHT_PX)))
    tile = site.client.get(f"{PLAN}/tiles/3/2/1.png").content
    archive = site.client.get("/venues/site/export").content
    sent = site.client.post("/venues/import", files={"archive": archive}, params={"as": "copy"})
    assert sent.status_code == 201, sent.text
    assert site.client.get("/venues/copy/floors/0").json()["plan"] == plan
    assert site.client.get("/venues/copy/floors/0/plan/tiles/3/2/1.png").content == tile


def test_tiles_that_are_damaged_or_hostile_are_refused(tmp_path: Any) -> None:
    path = tmp_path / "tiles"
    write_tiles(Image.new("L", (1500, 700), 255), path)
    grid = TileGrid(1500, 700)
    check_tiles(path, grid)
    assert grey(read_tile(path, grid, 2, 2, 1)).shape == (700 - 512, 1500 - 1024)
    good = path.read_bytes()
    start = len(MAGIC)
    bad = {
        "not ours": b"GIF89a" + good[6:],
        "cut off": good[: start + 20],
        "cut in a tile": good[:-9],
        "a tile before the tiles": good[:start] + bytes(8) + good[start + 8 :],
        "a tile beyond the end": good[:start] + b"\xff" * 12 + good[start + 12 :],
        "no picture": good.replace(b"\x89PNG", b"<htm"),
    }
    for data in bad.values():
        path.write_bytes(data)
        with pytest.raises(InvalidInputError, match="tiles of a plan"):
            check_tiles(path, grid)
    path.write_bytes(good)
    with pytest.raises(InvalidInputError):
        check_tiles(path, TileGrid(10**6, 10**6))
