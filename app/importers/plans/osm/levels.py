"""Values of the keys `level` and `repeat_on`."""

from __future__ import annotations

import re
from collections.abc import Mapping

NUMBER = r"-?\d{1,3}(?:\.\d{1,2})?"
RANGE = re.compile(rf"({NUMBER})-({NUMBER})")
MAX_LEVEL = 100


def levels_of(tags: Mapping[str, str]) -> list[float]:
    """Return the levels that an element is on, lowest first: `0;1`, `0-3`, `-1`, `0.5`; none for what is no level."""
    found: set[float] = set()
    for key in ("level", "repeat_on"):
        for part in tags.get(key, "").split(";"):
            text = part.strip()
            between = RANGE.fullmatch(text)
            if between is not None:
                first, last = sorted((float(between[1]), float(between[2])))
                found |= {float(level) for level in range(round(first), round(last) + 1)}
            elif re.fullmatch(NUMBER, text):
                found.add(float(text))
    return sorted(level for level in found if abs(level) <= MAX_LEVEL)


def orders_of(levels: list[float]) -> dict[float, int]:
    """Return a whole number for each level (ascending): the level itself, or its rank above 0 where some are between
    storeys."""
    if all(level.is_integer() for level in levels):
        return {level: int(level) for level in levels}
    base = next((rank for rank, level in enumerate(levels) if level >= 0), 0)
    return {level: rank - base for rank, level in enumerate(levels)}


def level_text(level: float) -> str:
    """Return a level as it is written in tags."""
    return f"{level:g}"
