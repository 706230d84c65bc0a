"""A camera that a scan states wrongly is the scan's error."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from app.errors import InvalidCameraError, InvalidScanError


@contextmanager
def camera_stated_in(where: str) -> Iterator[None]:
    """Turn the error of a camera that is made within the block into `InvalidScanError`, which names where the scan
    states it."""
    try:
        yield
    except InvalidCameraError as error:
        raise InvalidScanError(f"{where}: {error}") from None
