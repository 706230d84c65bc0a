"""The picture of a path, also of one that damaged poses make longer than any building."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.mapping.inspection.path_picture import MAX_GRID_LINES, path_picture


@pytest.mark.parametrize("length_m", [0.0, 3.0, 400.0, 1e6, 1e11])
def test_the_grid_has_few_lines(length_m: float) -> None:
    positions = np.array([[0.0, 0.0, 0.0], [length_m, 0.0, 0.0]])
    drawn = path_picture(positions, np.array([[1.0, 0.0, 0.0]] * 2), [0])
    # Of both axes, a margin and the two directions.
    assert drawn.count("<line") <= 2 * (1.3 * MAX_GRID_LINES + 1) + 2
