"""A page of a PDF as a picture, by PDFium."""

from __future__ import annotations

import pypdfium2
from PIL import Image

from app.errors import InvalidImageError
from app.importers.plan_images.order import DrawOrder
from app.importers.plan_images.pictures import check_page, check_pixels

POINTS_PER_INCH = 72.0
# In colour a sheet takes four times the memory, and lines need none.
MAX_COLOUR_PIXELS = 100_000_000


def draw_page(data: bytes, order: DrawOrder) -> Image.Image:
    """Return a page at `dpi`; raises `InvalidImageError`, `InvalidInputError`, `ImageTooLargeError`."""
    try:
        document = pypdfium2.PdfDocument(data)
        check_page(order.page, len(document))
        page = document[order.page - 1]
        scale = order.dpi / POINTS_PER_INCH
        width, height = (side * scale for side in page.get_size())
        check_pixels(width, height, order.max_pixels)
        is_grey = width * height > MAX_COLOUR_PIXELS
        bitmap = page.render(scale=scale, grayscale=is_grey, may_draw_forms=False, prefer_bgrx=False)
        image: Image.Image = bitmap.to_pil()
    except pypdfium2.PdfiumError as error:
        reason = "it needs a password" if "assword" in str(error) else str(error)
        raise InvalidImageError(f"The PDF can't be read: {reason.rstrip('.')}.") from None
    return image if image.mode in ("L", "RGB") else image.convert("RGB")
