"""Whether an image file asks to be turned when it is shown: EXIF, PNG's eXIf wherever it stands, XMP, HEIF boxes."""

from __future__ import annotations

import re
from typing import BinaryIO

from PIL import Image

from app.vision.image_files.formats import DAMAGE

ORIENTATION = 0x0112
UPRIGHT = 1
# Any of the seven others: the picture is turned or mirrored, and nobody asks how.
TURNED = 3

_PNG_SIGNATURE_BYTES = 8
_METADATA_CHUNKS = frozenset({b"eXIf", b"iTXt", b"tEXt", b"zTXt"})
# No encoder writes pieces of the pixels so small that a picture within the limits has more.
_MAX_CHUNKS = 100_000
# The boxes that turn or mirror a HEIF picture. irot: quarter turns; imir: the axis.
_HEIF_TURN = re.compile(rb"\x00\x00\x00\x09(?:irot[\x01-\x03]|imir)")


def has_metadata_behind_pixels(file: BinaryIO) -> bool:
    """Whether a PNG holds text or EXIF data behind its pixels; the file's position stays as it was."""
    position = file.tell()
    try:
        file.seek(_PNG_SIGNATURE_BYTES)
        behind_pixels = False
        for _ in range(_MAX_CHUNKS):
            head = file.read(8)
            kind = head[4:]
            if len(head) < 8 or kind == b"IEND":
                return False
            if behind_pixels and kind in _METADATA_CHUNKS:
                return True
            behind_pixels = behind_pixels or kind == b"IDAT"
            # A chunk's checksum follows its data.
            file.seek(int.from_bytes(head[:4], "big") + 4, 1)
        return True
    finally:
        file.seek(position)


def load_all_metadata(image: Image.Image, file: BinaryIO) -> None:
    """Bring what stands behind the pixels of a PNG into `image.info`, which decodes the image only if there is any.

    Raises what Pillow raises on damaged files (`DAMAGE`).
    """
    if image.format == "PNG" and "exif" not in image.info and has_metadata_behind_pixels(file):
        image.load()


def stored_orientation(image: Image.Image, file: BinaryIO) -> int:
    """Return the EXIF orientation (1 to 8) of an image that was opened from `file`; 1 where there is none.

    It is what the file states, also for HEIF, whose decoder turns the pixels itself. Tags that can't be read count
    as none, as they do when the image is decoded.
    """
    try:
        load_all_metadata(image, file)
        if image.format == "HEIF":
            return _heif_orientation(image, file)
        # Pillow's own method for PNG decodes every image that has no EXIF data in its header.
        value = Image.Image.getexif(image).get(ORIENTATION, UPRIGHT)
    except DAMAGE:
        return UPRIGHT
    return value if isinstance(value, int) and 1 <= value <= 8 else UPRIGHT


def _heif_orientation(image: Image.Image, file: BinaryIO) -> int:
    file.seek(0)
    if not _HEIF_TURN.search(file.read()):
        # EXIF's orientation turns no HEIF picture; its boxes do.
        return UPRIGHT
    return int(image.info.get("original_orientation") or TURNED)
