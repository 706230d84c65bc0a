"""A plan of many pixels as a pyramid of tiles, all in one file.

The file: `MAGIC`, an entry (offset, bytes) for each tile, and the tiles as PNG. Tiles are numbered by zoom, then row,
then column. Zoom 0 is the whole plan in one tile; each further zoom has twice the pixels, the last one all of them.
Equal tiles, such as empty ones, are stored once.
"""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from PIL import Image

from app.errors import InvalidInputError, NotFoundError

MAGIC = b"RFTILES1"
PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
ENTRY = struct.Struct("<QI")
TILE_PX = 512


@dataclass(frozen=True, slots=True)
class TileGrid:
    """How a picture of this size is cut into tiles of `tile_px` squared, smaller ones at its right and lower edge."""

    width_px: int
    height_px: int
    tile_px: int = TILE_PX

    @property
    def max_zoom(self) -> int:
        """The zoom that has all pixels."""
        tiles = -(-max(self.width_px, self.height_px) // self.tile_px)
        return (tiles - 1).bit_length()

    def shape(self, zoom: int) -> tuple[int, int]:
        """Return the columns and rows of tiles at a zoom."""
        side = self.tile_px << (self.max_zoom - zoom)
        return -(-self.width_px // side), -(-self.height_px // side)

    @property
    def count(self) -> int:
        """The number of tiles of all zooms."""
        return self._first(self.max_zoom + 1)

    def number(self, zoom: int, column: int, row: int) -> int:
        """Return a tile's number in the file; raises `NotFoundError`."""
        if not 0 <= zoom <= self.max_zoom:
            raise NotFoundError(f"The plan's tiles have zooms 0 to {self.max_zoom}, not {zoom}.")
        columns, rows = self.shape(zoom)
        if not (0 <= column < columns and 0 <= row < rows):
            raise NotFoundError(
                f"At zoom {zoom} the plan has {columns} x {rows} tiles, none at column {column}, row {row}."
            )
        return self._first(zoom) + row * columns + column

    def _first(self, zoom: int) -> int:
        shapes = (self.shape(before) for before in range(zoom))
        return sum(columns * rows for columns, rows in shapes)


def write_tiles(image: Image.Image, path: Path) -> None:
    """Write the pyramid of a picture in grey or RGB."""
    grid = TileGrid(image.width, image.height)
    entries: list[tuple[int, int]] = [(0, 0)] * grid.count
    known: dict[bytes, tuple[int, int]] = {}
    with path.open("wb") as file:
        file.write(MAGIC + bytes(grid.count * ENTRY.size))
        for zoom in range(grid.max_zoom, -1, -1):
            columns, rows = grid.shape(zoom)
            for row in range(rows):
                for column in range(columns):
                    entries[grid.number(zoom, column, row)] = _append(
                        file, _tile(image, column, row, grid.tile_px), known
                    )
            if zoom:
                image = image.reduce(2)
        file.seek(len(MAGIC))
        file.write(b"".join(ENTRY.pack(*entry) for entry in entries))


def _tile(image: Image.Image, column: int, row: int, side: int) -> Image.Image:
    left, top = column * side, row * side
    return image.crop((left, top, min(left + side, image.width), min(top + side, image.height)))


def _append(file: BinaryIO, tile: Image.Image, known: dict[bytes, tuple[int, int]]) -> tuple[int, int]:
    """Write a tile and return its entry; one of a single colour is looked up in `known` first."""
    buffer = io.BytesIO()
    tile.save(buffer, format="PNG")
    data = buffer.getvalue()
    if data in known:
        return known[data]
    entry = (file.tell(), len(data))
    file.write(data)
    if tile.getcolors(1) is not None:
        known[data] = entry
    return entry


def read_tile(path: Path, grid: TileGrid, zoom: int, column: int, row: int) -> bytes:
    """Return one tile as PNG, and read no more of the file than it; raises `NotFoundError`."""
    number = grid.number(zoom, column, row)
    with path.open("rb") as file:
        file.seek(len(MAGIC) + number * ENTRY.size)
        offset, length = ENTRY.unpack(file.read(ENTRY.size))
        file.seek(offset)
        return file.read(length)


def check_tiles(path: Path, grid: TileGrid) -> None:
    """Raise `InvalidInputError` for a file that is no pyramid of this grid, such as one that was sent."""
    end = path.stat().st_size
    start = len(MAGIC) + grid.count * ENTRY.size
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC or end < start:
            raise InvalidInputError("The tiles of a plan are damaged or of another size.")
        index = file.read(grid.count * ENTRY.size)
        for offset, length in set(ENTRY.iter_unpack(index)):
            if not (start <= offset and offset + length <= end):
                raise InvalidInputError("The tiles of a plan are damaged: one of them lies outside the file.")
            file.seek(offset)
            if file.read(len(PNG_MAGIC)) != PNG_MAGIC:
                raise InvalidInputError("The tiles of a plan are damaged: one of them is no PNG.")
