"""Descriptors of every place of an image, between which any pixel's is interpolated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Descriptors shorter than this, where opposite ones are interpolated, have no direction.
MIN_LENGTH = 1e-6


@dataclass(frozen=True, slots=True)
class DenseDescriptors:
    """One unit descriptor for each square cell of a network's input: `cells` (rows, columns, d).

    `input_from_image` (2, 3) leads from a pixel (u, v) of the image to a pixel of the input, whose cells have sides of
    `cell_px` pixels.
    """

    cells: NDArray[np.float32]
    input_from_image: NDArray[np.float64]
    cell_px: int

    def input_px(self, points_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return pixels (..., 2) of the image as pixels of the input."""
        return np.asarray(points_px @ self.input_from_image[:, :2].T + self.input_from_image[:, 2])

    def contains(self, points_px: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which pixels (..., 2) of the image lie between the centres of cells."""
        column, row = np.moveaxis(self._cell_coordinates(points_px), -1, 0)
        rows, columns = self.cells.shape[:2]
        return np.asarray((column >= 0) & (row >= 0) & (column <= columns - 1) & (row <= rows - 1))

    def at(self, points_px: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return the unit descriptors (n, d) at pixels (n, 2) of the image, bilinear between the centres of cells.

        Outside of these the nearest cell's is taken.
        """
        rows, columns = self.cells.shape[:2]
        place = np.clip(self._cell_coordinates(points_px), 0.0, [columns - 1, rows - 1])
        column, row = np.minimum(np.floor(place).astype(np.intp), [columns - 2, rows - 2]).T
        right, down = (place - np.stack([column, row], axis=1)).T[:, :, None].astype(np.float32)
        upper = (1 - right) * self.cells[row, column] + right * self.cells[row, column + 1]
        lower = (1 - right) * self.cells[row + 1, column] + right * self.cells[row + 1, column + 1]
        mixed = (1 - down) * upper + down * lower
        return np.asarray(mixed / np.maximum(np.linalg.norm(mixed, axis=1, keepdims=True), MIN_LENGTH))

    def sample(self, count: int) -> NDArray[np.float32]:
        """Return the unit descriptors (m, d) of at most `count` cells, spread at random, always the same ones."""
        rows = self.cells.reshape(-1, self.cells.shape[-1])
        chosen = rows[np.random.default_rng(0).permutation(len(rows))[:count]]
        return np.asarray(chosen / np.maximum(np.linalg.norm(chosen, axis=1, keepdims=True), MIN_LENGTH))

    def _cell_coordinates(self, points_px: NDArray[np.float64]) -> NDArray[np.float64]:
        return (self.input_px(points_px) + 0.5) / self.cell_px - 0.5
