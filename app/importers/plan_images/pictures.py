"""Pictures: PNG, JPEG and TIFF of many pixels or of one bit a pixel."""

from __future__ import annotations

import io

from PIL import Image, ImageOps, UnidentifiedImageError

from app.errors import ImageTooLargeError, InvalidImageError, InvalidInputError
from app.importers.plan_images.order import DrawOrder
from app.vision.image_files.formats import DAMAGE

FORMATS = {"png": "PNG", "jpeg": "JPEG", "tiff": "TIFF"}


def read_picture(data: bytes, order: DrawOrder) -> Image.Image:
    """Return a picture, upright, in grey or RGB; raises `InvalidImageError`."""
    # The limit is the order's, which is checked before anything is decoded.
    Image.MAX_IMAGE_PIXELS = None
    try:
        with Image.open(io.BytesIO(data), formats=[FORMATS[order.kind]]) as image:
            check_page(order.page, getattr(image, "n_frames", 1))
            image.seek(order.page - 1)
            check_pixels(image.width, image.height, order.max_pixels)
            # In place, since a copy of a large picture may not fit into memory.
            ImageOps.exif_transpose(image, in_place=True)
            image.load()
            return _plain(image)
    except UnidentifiedImageError:
        raise InvalidImageError("The image is damaged or cut short.") from None
    except InvalidInputError:
        raise
    except DAMAGE as error:
        raise InvalidImageError(f"The image is damaged or cut short ({error}).") from None


def check_page(page: int, pages: int) -> None:
    """Raise `InvalidInputError` for a page that a file doesn't have."""
    if page > pages:
        raise InvalidInputError(f"page is {page}, but the file has {pages}.")


def check_pixels(
    width: float, height: float, max_pixels: int, remedy: str = "send a smaller one, or choose a lower dpi"
) -> None:
    """Raise `ImageTooLargeError`, which says the remedy, for a picture of too many pixels."""
    if not width * height <= max_pixels:
        raise ImageTooLargeError(
            f"The plan has {_shown(width)} x {_shown(height)} pixels, the limit is {max_pixels:,} in all; {remedy}."
        )


def _shown(side: float) -> str:
    """Return a number of pixels with all its digits, unless they are too many to be read."""
    return f"{side:,.0f}" if side < 1e9 else f"{side:.3g}"


def _plain(image: Image.Image) -> Image.Image:
    """Return an image in grey or RGB, on white where it is transparent."""
    if image.mode in ("L", "RGB") and "transparency" not in image.info:
        return image
    if image.mode in ("1", "L"):
        return image.convert("L")
    if image.mode.startswith("I;16") or image.mode == "I":
        return image.point(lambda value: value * (1 / 256)).convert("L")
    if image.mode in ("RGBA", "LA", "PA") or "transparency" in image.info:
        layer = image.convert("RGBA")
        sheet = Image.new("RGB", layer.size, "white")
        sheet.paste(layer, mask=layer.getchannel("A"))
        return sheet
    return image.convert("RGB")
