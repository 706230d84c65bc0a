"""A camera or stream that is read without pause, so that its newest picture is always at hand."""

from __future__ import annotations

import threading

import cv2
import numpy as np
from numpy.typing import NDArray

from app.commands.backoff import Backoff
from app.commands.console import errors
from app.errors import InvalidInputError

Bgr = NDArray[np.uint8]


class LiveCapture:
    """A device, or a stream by its URL.

    A thread reads it without pause: frames that nobody reads queue up in the driver or network, and are old once
    they are read. A stream that breaks is opened again after a pause that grows (`Backoff`).
    """

    def __init__(self, source: str) -> None:
        """Open a device by its number or a stream by its URL; raises `InvalidInputError` when that can't be done."""
        self._source = source
        capture = _opened(source)
        if capture is None:
            raise InvalidInputError(
                f"{source} is no picture, no folder, and no camera or stream that can be opened."
            )
        self._changed = threading.Condition()
        self._newest: Bgr | None = None
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._read_on, args=(capture,), daemon=True)
        self._thread.start()

    def take(self) -> Bgr:
        """Return the newest picture (height, width, 3), or wait for it; each picture is returned at most once."""
        with self._changed:
            self._changed.wait_for(lambda: self._newest is not None)
            newest, self._newest = self._newest, None
        assert newest is not None  # noqa: S101 - waited for
        return newest

    def close(self) -> None:
        """Stop reading."""
        self._stopped.set()
        self._thread.join()

    def _read_on(self, capture: cv2.VideoCapture | None) -> None:
        backoff = Backoff()
        while not self._stopped.is_set():
            read, image = (False, None) if capture is None else capture.read()
            if read and image is not None:
                backoff.reset()
                with self._changed:
                    self._newest = np.asarray(image, dtype=np.uint8)
                    self._changed.notify_all()
                continue
            if capture is not None:
                capture.release()
            pause_s = backoff.next_pause_s()
            errors.print(f"{self._source} gives no pictures; opening it again in {pause_s:.0f} s")
            self._stopped.wait(pause_s)
            capture = None if self._stopped.is_set() else _opened(self._source)
        if capture is not None:
            capture.release()


def _opened(source: str) -> cv2.VideoCapture | None:
    capture = cv2.VideoCapture(int(source)) if source.isdigit() else cv2.VideoCapture(source)
    return capture if capture.isOpened() else None
