"""Reading JSON files that nobody vouches for."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidScanError
from app.importers.scan_files import read_text


def read_json_object(path: Path) -> dict[str, Any]:
    """Return the object of a JSON file; raises `InvalidScanError` that names the file and the place."""
    try:
        value = json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise InvalidScanError(f"{path.name} line {error.lineno} is not JSON: {error.msg}.") from None
    except RecursionError:
        raise InvalidScanError(f"{path.name} is nested too deeply.") from None
    if not isinstance(value, dict):
        raise InvalidScanError(f"{path.name} must hold a JSON object.")
    return value


def number_of(values: Mapping[str, Any], key: str, where: str) -> float:
    """Return a number of a JSON object; raises `InvalidScanError` for anything else, NaN among it."""
    value = values.get(key)
    # An integer of JSON may have more digits than a float holds.
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= sys.float_info.max:
        raise InvalidScanError(f"{where}: {key} must be a number.")
    return float(value)


def matrix_of(value: object, where: str) -> NDArray[np.float64] | None:
    """Return a 4x4 matrix, or a 3x4 with its last row added; None if a number in it is not finite.

    Raises `InvalidScanError` for another shape.
    """
    try:
        matrix = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.zeros(0)
    if matrix.shape not in ((4, 4), (3, 4)):
        raise InvalidScanError(f"{where} must be a matrix of four (or three) rows of four numbers.")
    if not np.isfinite(matrix).all():
        return None
    return matrix if len(matrix) == 4 else np.vstack([matrix, [0.0, 0.0, 0.0, 1.0]])
