"""Which image files are read, and which of the others are known by name."""

from __future__ import annotations

import re
import struct
from typing import BinaryIO

import pillow_heif
from PIL import Image

from app.vision.image_files.avif_size import ANIMATED, largest_coded_pixels

# Only the photo itself is wanted: no thumbnails, depth maps or other pictures that a HEIC file may hold.
pillow_heif.register_heif_opener(decode_threads=1, thumbnails=False, depth_images=False, aux_images=False)

# Pillow's names. HEIF are the HEIC files of phones.
FORMATS = ("JPEG", "PNG", "WEBP", "HEIF", "AVIF", "TIFF")
FORMATS_IN_WORDS = "JPEG, PNG, WebP, HEIC, AVIF or TIFF"
# What files of these formats are called.
PICTURE_SUFFIXES = frozenset(
    {".jpg", ".jpeg", ".jpe", ".png", ".webp", ".heic", ".heif", ".avif", ".tif", ".tiff"}
)
# All that Pillow and its plugins were seen to raise on damaged files and tags.
DAMAGE = (
    OSError, SyntaxError, ValueError, EOFError, KeyError, IndexError, TypeError, AttributeError, OverflowError,
    ZeroDivisionError, RuntimeError, struct.error,
)  # fmt: skip

RAW_PHOTO = "a raw photo"
# What `open_image` refuses by name.
NAMED = (RAW_PHOTO, ANIMATED)
# A file that holds nothing but text.
TEXT = "text"
# What people send by mistake: the first bytes, and what a file that begins with them is.
_OTHER_FORMATS = (
    (rb"GIF8", "a GIF image"),
    (rb"BM", "a BMP image"),
    (rb"P[1-6]\s", "a PNM image (PBM, PGM or PPM)"),
    (rb"\x00\x00\x00\x0cjP  |\xff\x4f\xff\x51", "a JPEG 2000 image"),
    (rb"\xff\x0a|\x00\x00\x00\x0cJXL ", "a JPEG XL image"),
    (rb"8BPS", "a Photoshop file"),
    (rb"%PDF", "a PDF file"),
    (rb"\s*<(?:svg|\?xml|!DOCTYPE|html)", "a text file (SVG, XML or HTML)"),
    (rb"v/1\x01", "an OpenEXR image"),
    (rb"#\?RADIANCE|#\?RGBE", "a Radiance HDR image"),
    (rb"(?s)....ftyp(?:qt|mp4|isom|iso\d|M4V|3gp|avc1)", "a video"),
    (rb"\x1aE\xdf\xa3|(?s:RIFF....AVI )", "a video"),
    (rb"(?s)II\x2a\x00....CR\x02|II\x55\x00|IIR[OS]|FUJIFILMCCD-RAW|(?s:....ftypcrx)", RAW_PHOTO),
    (rb"PK\x03\x04|\x1f\x8b|7z\xbc\xaf|Rar!", "an archive"),
    # The first bytes of JPEG, PNG, WebP and HEIC in base64.
    (
        rb"/9j/[\w+/]{4}|iVBORw0KGgo|UklGR[\w+/]{4}|AAAA\w{2}Z0eXB|data:image/",
        "a picture as base64 text, not its bytes",
    ),
    # Of JPEG and PNG as text: bytes replaced, or taken for Latin-1, by a client that reads the file as text.
    (
        rb"\xef\xbf\xbd(?:\xef\xbf\xbd\xef\xbf\xbd|PNG)|\xc3\xbf\xc3\x98\xc3\xbf|\xc2\x89PNG",
        "a picture that was read as text, which destroys its bytes",
    ),
    (rb"[\t\n\r -~]{1,64}\Z", TEXT),
)
# How files of `FORMATS` begin, but for those whose first bytes are shared with videos.
_BEGINNINGS = (
    (rb"\xff\xd8\xff", "JPEG"),
    (rb"\x89PNG\r\n\x1a\n", "PNG"),
    (rb"(?s)RIFF....WEBP", "WebP"),
    (rb"II[\x2a\x2b]\x00|MM\x00[\x2a\x2b]", "TIFF"),
)
# A coded picture is larger than the image by up to a block of 128 pixels on each side.
CODED_MARGIN = 2
MIN_CODED_PIXELS = 256 * 256
_NEW_SUBFILE_TYPE = 0x00FE
_DNG_VERSION = 0xC612
_REDUCED_COPY = 1


def name_of_other_format(head: bytes) -> str:
    """Return what a file that is not read begins like, as `a GIF image`, or nothing; `head` is its first 64 bytes."""
    return next((name for magic, name in _OTHER_FORMATS if re.match(magic, head)), "")


def begun_format(head: bytes) -> str:
    """Return the format, of those that are read, that a file begins like, or nothing; `head` is its first 64 bytes."""
    return next((name for magic, name in _BEGINNINGS if re.match(magic, head)), "")


def open_image(file: BinaryIO) -> Image.Image:
    """Return the image of a file with nothing but its header read.

    Raises `PIL.UnidentifiedImageError` for other formats, and `ValueError` for raw photos, whose first image is a
    small preview, for animated AVIF (both with a word of `NAMED`), and for files whose header understates what would be
    decoded.
    """
    if name_of_other_format(file.read(64)) == RAW_PHOTO:
        raise ValueError(RAW_PHOTO)
    file.seek(0)
    image = Image.open(file, formats=FORMATS)
    if image.format == "AVIF":
        file.seek(0)
        if largest_coded_pixels(file.read()) > CODED_MARGIN * max(
            image.width * image.height, MIN_CODED_PIXELS
        ):
            raise ValueError("its pictures are larger than it says")
    if image.format == "TIFF":
        tags = getattr(image, "tag_v2", {})
        if _DNG_VERSION in tags or tags.get(_NEW_SUBFILE_TYPE, 0) == _REDUCED_COPY:
            raise ValueError(RAW_PHOTO)
    return image
