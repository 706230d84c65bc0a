"""Plan images of floors: checked and stored."""

from __future__ import annotations

import io
import math
import re
import sys
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from PIL import Image, UnidentifiedImageError
from sqlalchemy import Connection

from app.engine.floors.floor import Floor, PlanImage, PlanTiles
from app.errors import InvalidInputError, NotFoundError, StorageError
from app.importers.plan_images.order import INCH_M, OPTIONS, SHOWN_KINDS, Drawn, DrawOrder, kind_of
from app.importers.plan_images.tiles import TileGrid, read_tile
from app.limits import limit
from app.services.plans.draw_plan import draw_plan
from app.services.resources import Resources
from app.storage.db import hold_blobs
from app.storage.floors import get_floor, set_plan_image
from app.vision.image_files.formats import DAMAGE, name_of_other_format
from app.vision.images import decode_image

PLAN_FORMATS_IN_WORDS = "PNG, JPEG, TIFF, PDF, SVG or DXF"
# Files of drawings that are not read, by how they begin.
OTHER_DRAWINGS = (
    (b"AC10", "DWG (save it as DXF)"),
    (b"ISO-10303-21", "IFC or STEP (export the storey as PDF or DXF)"),
    (b"%!PS", "PostScript (save it as PDF)"),
    (b"RIFF", "WebP"),
    (b"\x1f\x8b", "gzip (unpack an SVGZ to SVG)"),
    (b"\xd0\xcf\x11\xe0", "a file of Visio or Office (export it as PDF)"),
)
MIN_METERS_PER_PIXEL = 1e-5
MAX_METERS_PER_PIXEL = 10
# Of pages larger than 200 inches, by which PDFium doesn't multiply; 1 is the default.
USER_UNIT = re.compile(rb"/UserUnit\s+(?!1(?:\.0*)?[^\d.])[\d.]+")
SCALE = re.compile(r"(?:1\s*:)?\s*(\d+(?:\.\d+)?)")


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredPlanOptions:
    """Which plans are stored."""

    max_size_m: float = limit(
        10_000.0,
        "Longer side of a plan.",
        chosen="By hand: no venue is larger; a scale upside down, or millimetres taken for metres, is.",
    )
    max_origin_px: float = limit(
        1e9,
        "Largest distance of plan (0, 0) from the picture's first pixel.",
        chosen="By hand: drawings in coordinates of a map grid have it thousands of kilometres away.",
    )
    agreement_ratio: float = limit(
        0.02,
        "Relative difference of two statements of a plan's scale that agree.",
        chosen="By hand: numbers that were rounded.",
    )


PLAN = StoredPlanOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanFile:
    """A plan as it was sent, and what its sender says of it.

    `meters_per_pixel` and `origin_px` are of the picture as it is, or as it is drawn at `dpi`. `scale` is `1:100` or
    100; `page` counts from 1; `units` are those of a DXF.
    """

    data: bytes
    meters_per_pixel: float | None = None
    origin_px: tuple[float, float] | None = None
    page: int = 1
    dpi: float | None = None
    scale: str | None = None
    units: str | None = None


@dataclass(frozen=True, slots=True)
class PlanTile:
    """A tile of a plan: a digest of what it is, and how its PNG is read."""

    digest: str
    read: Callable[[], bytes]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Picture:
    """A picture that is stored as a plan; `drawn` is its size before it was reduced, `tiles` those of a large one."""

    data: bytes
    media_type: str
    drawn: Drawn
    tiles: PlanTiles | None = None


def store_plan_image(resources: Resources, venue_id: str, floor_id: str, file: PlanFile) -> Floor:
    """Check and store a floor's plan, drawn as PNG where it is no picture that can be shown.

    Raises `InvalidImageError`, `InvalidInputError`, `NotFoundError`.
    """
    _check_fields(file)
    meters_per_pixel = _meters_per_pixel(file)
    if file.origin_px is not None and not all(abs(each) <= PLAN.max_origin_px for each in file.origin_px):
        raise InvalidInputError("origin_px must be two numbers: the pixel of plan (0, 0), near the plan.")
    picture = _picture(resources, file, has_tiles=True)
    drawn = picture.drawn
    meters_per_pixel = meters_per_pixel or drawn.meters_per_pixel
    if meters_per_pixel is None:
        raise InvalidInputError("Give meters_per_pixel, or scale (such as 1:100) and dpi.")
    _check_size(meters_per_pixel, drawn)
    _check_scale(meters_per_pixel)
    origin = file.origin_px or drawn.origin_px or (0.0, drawn.height_px - 1.0)
    # A pixel of a reduced picture is the middle of the pixels that it was made from.
    factor, shift = drawn.reduced_by, (drawn.reduced_by - 1) / 2
    plan = PlanImage(
        blob=resources.blobs.put(picture.data),
        media_type=picture.media_type,
        width_px=-(-drawn.width_px // factor),
        height_px=-(-drawn.height_px // factor),
        meters_per_pixel=meters_per_pixel * factor,
        origin_px=((origin[0] - shift) / factor, (origin[1] - shift) / factor),
        tiles=picture.tiles,
    )
    with resources.database.write() as connection:
        hold_blobs(connection)
        if not resources.blobs.contains(plan.blob):
            resources.blobs.put(picture.data)
        if plan.tiles is not None and not resources.blobs.contains(plan.tiles.blob):
            raise StorageError("The plan's tiles were swept while it was stored; send it again.")
        return set_plan_image(
            connection, venue_id, floor_id, _with_known_tiles(connection, plan, venue_id, floor_id)
        )


def _with_known_tiles(connection: Connection, plan: PlanImage, venue_id: str, floor_id: str) -> PlanImage:
    """Keep the tiles of the picture that the floor has already, which is sent again for another scale."""
    before = get_floor(connection, venue_id, floor_id).plan
    if before is None or before.tiles is None or before.blob != plan.blob:
        return plan
    return replace(plan, tiles=before.tiles)


def plan_tile(
    resources: Resources, venue_id: str, floor_id: str, zoom: int, column: int, row: int
) -> PlanTile:
    """Return a tile of a floor's plan; raises `NotFoundError` where there is none."""
    with resources.database.read() as connection:
        plan = get_floor(connection, venue_id, floor_id).plan
    if plan is None or plan.tiles is None:
        raise NotFoundError(
            f"Floor {floor_id!r} has no plan of so many pixels that it has tiles; get its plan."
        )
    tiles = plan.tiles
    number = tiles.grid.number(zoom, column, row)
    return PlanTile(
        digest=f"{tiles.blob}-{number}",
        read=lambda: read_tile(resources.blobs.local_path(tiles.blob), tiles.grid, zoom, column, row),
    )


def plan_picture(resources: Resources, file: PlanFile) -> tuple[bytes, str]:
    """Return the picture that a plan's file would be stored as, and its media type; stores nothing. Raises as
    `store_plan_image`."""
    picture = _picture(resources, file, has_tiles=False)
    return picture.data, picture.media_type


def _meters_per_pixel(file: PlanFile) -> float | None:
    """Return what one pixel shows, by `meters_per_pixel`, or by `scale` and `dpi`; None when neither is given."""
    by_scale = _by_scale(file)
    if file.meters_per_pixel is None:
        return by_scale
    _check_scale(file.meters_per_pixel)
    if by_scale is not None and not math.isclose(
        by_scale, file.meters_per_pixel, rel_tol=PLAN.agreement_ratio
    ):
        raise InvalidInputError(
            f"scale says {by_scale:.4g} m for a pixel, meters_per_pixel {file.meters_per_pixel:g}: give one."
        )
    return file.meters_per_pixel


def _by_scale(file: PlanFile) -> float | None:
    """Return what one pixel shows by `scale` and `dpi`, None without a scale."""
    if file.scale is None:
        return None
    stated = SCALE.fullmatch(file.scale.strip())
    if stated is None or float(stated[1]) < 1:
        raise InvalidInputError("scale must be such as 1:100 or 100.")
    kind = kind_of(file.data)
    if kind in SHOWN_KINDS or kind == "tiff":
        if file.dpi is None:
            raise InvalidInputError("scale of a picture needs dpi, the dots an inch that it was scanned at.")
        return INCH_M / file.dpi * float(stated[1])
    return INCH_M / (file.dpi or DrawOrder(kind="pdf").dpi) * float(stated[1])


def _check_fields(file: PlanFile) -> None:
    """Raise `InvalidInputError` for what is said of a plan's file and is nothing that files of its kind have."""
    kind = kind_of(file.data)
    if kind == "dxf" and file.scale is not None:
        raise InvalidInputError(
            "A DXF is drawn to its own size: leave scale out, and give units where the file states none."
        )
    if kind == "pdf" and file.scale is not None and USER_UNIT.search(file.data):
        raise InvalidInputError(
            "The PDF states its size in a unit of its own (UserUnit): give meters_per_pixel in place of scale."
        )
    if kind not in ("pdf", "tiff", None) and file.page != 1:
        raise InvalidInputError(f"page is {file.page}, but the file has 1.")


def _check_scale(meters_per_pixel: float) -> None:
    if not (
        np.isfinite(meters_per_pixel) and MIN_METERS_PER_PIXEL <= meters_per_pixel <= MAX_METERS_PER_PIXEL
    ):
        raise InvalidInputError(
            f"meters_per_pixel must be between 0.00001 and {MAX_METERS_PER_PIXEL}. Is it the number of pixels in a "
            "metre? Then give 1 divided by it."
        )


def _check_size(meters_per_pixel: float, drawn: Drawn) -> None:
    """Raise `InvalidInputError` for a plan that is larger than any venue."""
    size_m = meters_per_pixel * max(drawn.width_px, drawn.height_px)
    if size_m > PLAN.max_size_m and drawn.meters_per_pixel is not None:
        raise InvalidInputError(
            f"The drawing is {size_m / 1000:,.0f} km long; at most {PLAN.max_size_m / 1000:g} km are taken. Give its "
            "units, and delete what lies far outside of the storey."
        )
    if size_m > PLAN.max_size_m:
        raise InvalidInputError(
            f"With {meters_per_pixel:g} meters_per_pixel the plan would be {size_m / 1000:,.0f} km long; at most "
            f"{PLAN.max_size_m / 1000:g} km are taken. Is it the number of pixels in a metre?"
        )


def _picture(resources: Resources, file: PlanFile, *, has_tiles: bool) -> _Picture:
    """Return the picture that is stored; with `has_tiles` those of a large one are stored already."""
    kind = kind_of(file.data)
    if kind is None and file.data:
        raise InvalidInputError(f"A plan must be a {PLAN_FORMATS_IN_WORDS} file{_not_that(file.data)}.")
    shown_pixels = resources.settings.max_image_pixels
    if kind is None or (kind in SHOWN_KINDS and _pixels(file.data) <= shown_pixels):
        height, width = decode_image(file.data, shown_pixels).shape[:2]
        drawn = Drawn(width_px=width, height_px=height)
        if kind is None or not has_tiles or width * height <= OPTIONS.min_tiled_pixels:
            return _Picture(data=file.data, media_type=SHOWN_KINDS[kind or "png"], drawn=drawn)
    order = DrawOrder(
        kind=kind,
        page=file.page,
        dpi=file.dpi or DrawOrder(kind=kind).dpi,
        meters_per_pixel=file.meters_per_pixel,
        units=file.units,
        max_pixels=max(resources.settings.max_plan_pixels, shown_pixels),
        shown_pixels=shown_pixels,
        has_tiles=has_tiles,
    )
    made = draw_plan(file.data, order, resources.scratch_dir, resources.blobs)
    tiles = None
    if made.tiles_blob is not None:
        grid = TileGrid(made.drawn.width_px, made.drawn.height_px)
        tiles = PlanTiles(blob=made.tiles_blob, grid=grid, reduced_by=made.drawn.reduced_by)
    return _Picture(
        data=file.data if made.picture is None else made.picture,
        media_type=SHOWN_KINDS["png" if made.picture is not None else kind],
        drawn=made.drawn,
        tiles=tiles,
    )


def _not_that(data: bytes) -> str:
    """Return what a file is that is no plan, as the end of a sentence; empty where that is unknown."""
    drawing = next((name for magic, name in OTHER_DRAWINGS if data.startswith(magic)), None)
    name = drawing or name_of_other_format(data[:64])
    return f", not {name}" if name else ""


def _pixels(data: bytes) -> int:
    """Return the number of pixels in a picture's header, 0 where it can't be read."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(io.BytesIO(data), formats=["PNG", "JPEG"]) as image:
                return image.width * image.height
    except (*DAMAGE, UnidentifiedImageError):
        return 0
    except Image.DecompressionBombError:
        return sys.maxsize


def _tiles_as_dict(tiles: PlanTiles) -> dict[str, int]:
    return {**asdict(tiles.grid), "max_zoom": tiles.grid.max_zoom, "reduced_by": tiles.reduced_by}


def as_dict(floor: Floor) -> dict[str, Any]:
    """Return a floor as the API shows it."""
    plan = floor.plan
    return {
        "venue": floor.venue_id,
        "id": floor.id,
        "name": floor.name,
        "level": floor.level,
        "z_min_m": floor.z_min_m,
        "z_max_m": floor.z_max_m,
        "plan_from_world": None if floor.plan_from_world is None else floor.plan_from_world.tolist(),
        "plan_residual_m": floor.plan_residual_m,
        "plan": None
        if plan is None
        else {
            "media_type": plan.media_type,
            "width_px": plan.width_px,
            "height_px": plan.height_px,
            "meters_per_pixel": plan.meters_per_pixel,
            "origin_px": list(plan.origin_px),
            "tiles": None if plan.tiles is None else _tiles_as_dict(plan.tiles),
        },
    }
