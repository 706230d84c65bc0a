"""A sample of a scan's keyframes, from which its lens and its depth sensor are learned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from app.limits import limit

T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorSampleOptions:
    """How much of a scan its lens and its depth sensor are learned from."""

    max_keyframes: int = limit(
        40,
        "Largest number of keyframes that the lens, or the response of the depth sensor, is learned from.",
        chosen="By hand: more keyframes add little to a model of a few coefficients.",
    )


OPTIONS = SensorSampleOptions()


def every_nth(values: Sequence[T], count: int) -> list[T]:
    """Return every n-th value from the first on, with the smallest n that leaves at most `count` values."""
    return list(values)[:: max(1, -(-len(values) // count))]
