"""Seeded random fields, the raw material of every procedural texture."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import cv2
import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float32]


_BUILDING: ContextVar[int] = ContextVar("building", default=0)


def seeded(*keys: str | int) -> np.random.Generator:
    """Return a generator that depends on nothing but the keys (Python's own hash differs from run to run), and on the
    number of the building that is made (`building`)."""
    number = _BUILDING.get()
    numbers = [zlib.crc32(str(key).encode()) for key in keys]
    return np.random.default_rng([*numbers, number] if number else numbers)


@contextmanager
def building(number: int) -> Iterator[None]:
    """Make everything that is seeded within differ by the number of a building; 0 is the demonstration's."""
    token = _BUILDING.set(number)
    try:
        yield
    finally:
        _BUILDING.reset(token)


def fractal(rng: np.random.Generator, height: int, width: int, slope: float = 1.0) -> Field:
    """Return periodic noise (height, width) of zero mean and unit deviation whose spectrum falls as
    1/f^slope."""
    white = rng.standard_normal((height, width), dtype=np.float32)
    fy = np.fft.fftfreq(height)[:, None] * height
    fx = np.fft.rfftfreq(width)[None, :] * width
    frequency = np.maximum(np.hypot(fx, fy), 1.0)
    field = np.fft.irfft2(np.fft.rfft2(white) / frequency**slope, s=(height, width))
    field -= field.mean()
    return np.asarray(field / (field.std() + 1e-9), dtype=np.float32)


def stretched(rng: np.random.Generator, height: int, width: int, sigma_x: float, sigma_y: float) -> Field:
    """Return periodic noise (height, width) of unit deviation, correlated over sigma_x, sigma_y texels."""
    white = rng.standard_normal((height, width), dtype=np.float32)
    py, px = int(3 * sigma_y) + 1, int(3 * sigma_x) + 1
    padded = cv2.copyMakeBorder(white, py, py, px, px, cv2.BORDER_WRAP)
    field = cv2.GaussianBlur(padded, (0, 0), sigmaX=max(sigma_x, 0.01), sigmaY=max(sigma_y, 0.01))
    field = field[py : py + height, px : px + width]
    return np.asarray((field - field.mean()) / (field.std() + 1e-9), dtype=np.float32)


def cloud(rng: np.random.Generator, height: int, width: int) -> Field:
    """Return soft noise (height, width) of about unit deviation; cheap, since drawn small and enlarged."""
    small = fractal(rng, 64, 64, 1.3)
    return np.asarray(cv2.resize(small, (width, height), interpolation=cv2.INTER_CUBIC), dtype=np.float32)
