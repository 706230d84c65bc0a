"""Depth that lies beside its colour picture: the shift at which edges in depth meet edges in the picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, rfft2

from app.limits import limit
from app.vision.images import Gray, shrink

Array = NDArray[np.float32]
Spectrum = NDArray[np.complex64]
DepthImage = NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthShiftOptions:
    """How edges are found and compared."""

    side_px: int = limit(
        320,
        "Longer side of the pictures that are compared.",
        chosen="By hand: half of 640, a shift shows to 2 px.",
    )
    min_step_ratio: float = limit(
        1.06,
        "Depth between neighbouring pixels by which an edge begins.",
        chosen="By hand: above noise and slopes.",
    )
    reach_ratio: float = limit(
        0.15, "Shifts are searched up to this part of the longer side.", chosen="By hand: 96 px of 640."
    )
    min_edge_pixels: int = limit(
        600, "Edge pixels in all pictures together, below which nothing is said.", chosen="By hand."
    )


OPTIONS = DepthShiftOptions()


@dataclass(frozen=True, slots=True)
class DepthShift:
    """By how much depth must be moved (right, down), in pixels of the colour picture, for its edges to meet those of
    the picture. `peak` and `unmoved` are the agreement there and as it is, in standard deviations over all shifts."""

    right_px: float
    down_px: float
    peak: float
    unmoved: float


@dataclass(frozen=True, slots=True)
class SmallPicture:
    """A grey picture and its depth in metres, both (h, w), reduced by `scale`."""

    gray: Gray
    depth_m: DepthImage
    scale: float

    @staticmethod
    def of(gray: Gray, depth_m: DepthImage) -> SmallPicture:
        """Reduce a picture and its depth to the size at which shifts are measured."""
        small, scale = shrink(gray, OPTIONS.side_px)
        return SmallPicture(small, _small(depth_m, small), scale)


def measure_depth_shift(pictures: Sequence[SmallPicture]) -> DepthShift | None:
    """Return the shift on which most pictures agree.

    Cross-correlation of occlusion edges in depth with gradients of the picture, summed over the pictures. None where
    there are hardly any edges in depth.
    """
    spectra: dict[tuple[int, ...], Spectrum] = {}
    edge_pixels, scale, reach = 0, 1.0, 0
    for picture in pictures:
        scale = picture.scale
        reach = round(OPTIONS.reach_ratio * max(picture.gray.shape))
        edges = _depth_edges(picture.depth_m)
        edge_pixels += int(edges.sum())
        found = _cross_spectrum(edges, _gradients(picture.gray), reach)
        spectra[picture.gray.shape] = spectra.get(picture.gray.shape, 0) + found
    if edge_pixels < OPTIONS.min_edge_pixels:
        return None
    total = np.sum([_correlation(spectrum, shape, reach) for shape, spectrum in spectra.items()], axis=0)
    # A picture has more gradients in its middle or its lower half: only what is sharper than that counts.
    sharp = np.asarray(
        cv2.GaussianBlur(total - cv2.GaussianBlur(total, (0, 0), reach / 4), (0, 0), 1.0), np.float32
    )
    sharp = (sharp - sharp.mean()) / max(float(sharp.std()), 1e-12)
    row, column = np.unravel_index(int(np.argmax(sharp)), sharp.shape)
    return DepthShift(
        right_px=float(column - reach) / scale,
        down_px=float(row - reach) / scale,
        peak=float(sharp[row, column]),
        unmoved=float(sharp[reach - 1 : reach + 2, reach - 1 : reach + 2].max()),
    )


def _small(depth_m: DepthImage, gray: Gray) -> DepthImage:
    height, width = gray.shape
    return np.asarray(cv2.resize(depth_m, (width, height), interpolation=cv2.INTER_NEAREST), dtype=np.float32)


def _depth_edges(depth_m: DepthImage) -> Array:
    """Return 1 at the nearer side of steps in depth, else 0; where depth is missing there is none."""
    kernel = np.ones((3, 3), np.uint8)
    farthest = cv2.dilate(depth_m, kernel)
    nearest = cv2.erode(np.where(depth_m > 0, depth_m, np.float32(1e6)).astype(np.float32), kernel)
    step = (depth_m > 0) & (farthest > OPTIONS.min_step_ratio * depth_m) & (nearest > 0.97 * depth_m)
    return np.asarray(step, dtype=np.float32)


def _gradients(gray: Gray) -> Array:
    smooth = cv2.GaussianBlur(gray, (0, 0), 1.0).astype(np.float32)
    size = np.hypot(cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1))
    # A strong edge counts as an edge, not as many.
    clipped = np.minimum(size, np.quantile(size, 0.9))
    spread = max(float(clipped.std()), 1e-6)
    return np.asarray((clipped - clipped.mean()) / spread, dtype=np.float32)


def _cross_spectrum(edges: Array, gradients: Array, reach: int) -> Spectrum:
    """Return the Fourier transform of the cross-correlation of gradients with edges, padded against wrapping."""
    size = _padded(edges.shape, reach)
    return np.asarray(rfft2(gradients, size) * np.conj(rfft2(edges, size)))


def _correlation(spectrum: Spectrum, shape: tuple[int, ...], reach: int) -> Array:
    """Return the sum of gradients at edges moved by (down, right), (2 reach + 1, 2 reach + 1)."""
    product = irfft2(spectrum, _padded(shape, reach))
    return np.asarray(np.roll(product, (reach, reach), axis=(0, 1))[: 2 * reach + 1, : 2 * reach + 1])


def _padded(shape: tuple[int, ...], reach: int) -> tuple[int, ...]:
    return tuple(cv2.getOptimalDFTSize(side + 2 * reach) for side in shape)
