"""Times of a list: their unit, and whether they differ at all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidScanError
from app.limits import limit

Times = NDArray[np.float64]

# Seconds since 1970 pass this in the year 5138: what is larger is in a smaller unit.
LARGEST_SECONDS = 1e11
UNITS_PER_S = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeOptions:
    """When times can't be those of frames one after the other."""

    min_distinct_ratio: float = limit(
        0.5,
        "A list in which the different times are fewer than this ratio of its rows was printed with too few digits.",
        chosen="By hand: a tracker that repeats rows repeats a few; lost digits merge tens of rows.",
    )
    min_step_s: float = limit(
        1e-4,
        "A unit in which rows are nearer to each other is not the unit of the list.",
        chosen="By hand: trackers write up to 1000 rows a second.",
    )
    max_step_s: float = limit(
        20.0,
        "A unit in which rows are farther apart is not the unit of the list.",
        chosen="By hand: a scan of fewer frames has no two that show one place.",
    )
    max_ratio: float = limit(
        100.0,
        "A time of more than this ratio of the list's median is damaged.",
        chosen="By hand: of evenly spaced rows the last has twice the median; units differ by 1000.",
    )
    min_epoch_s: float = limit(
        3e8, "Seconds since 1970 are later than this.", chosen="By hand: 1979, before any digital camera."
    )
    max_epoch_s: float = limit(
        4e9, "Seconds since 1970 are earlier than this.", chosen="By hand: 2096; a clock may be set wrongly."
    )


OPTIONS = TimeOptions()


@dataclass(frozen=True, slots=True)
class TimesInSeconds:
    """Times (n,) in seconds, and the unit that they were given in."""

    times_s: Times
    unit: str = "seconds"


def in_seconds(times: Times) -> TimesInSeconds:
    """Return the times (n,) of a list in seconds.

    Times that are too large for seconds are milli-, micro- or nanoseconds: of the units in which rows are apart as
    those of a scan are, the one in which they are seconds since 1970, else the largest.
    """
    finite = _without_strays(times[np.isfinite(times)])
    largest = float(np.abs(finite).max()) if len(finite) else 0.0
    if largest < LARGEST_SECONDS:
        return TimesInSeconds(times)
    steps = np.diff(np.unique(finite))
    step = float(np.median(steps)) if len(steps) else 0.0
    fitting = {
        unit: per_s
        for unit, per_s in UNITS_PER_S.items()
        if len(steps) == 0 or OPTIONS.min_step_s <= step / per_s <= OPTIONS.max_step_s
    }
    since_1970 = [
        unit
        for unit, per_s in fitting.items()
        if OPTIONS.min_epoch_s <= largest / per_s <= OPTIONS.max_epoch_s
    ]
    unit = next(iter([*since_1970, *fitting]), None)
    return TimesInSeconds(times) if unit is None else TimesInSeconds(times / UNITS_PER_S[unit], unit)


def _without_strays(times: Times) -> Times:
    """Return the times but those so far above the usual one that they are no times of this list: the unit of all rows
    is not to hang on a damaged one."""
    usual = float(np.median(np.abs(times))) if len(times) else 0.0
    return times[np.abs(times) <= OPTIONS.max_ratio * usual] if usual > 0 else times


def check_distinct(lists: dict[str, Times]) -> None:
    """Raise `InvalidScanError` if most rows of a list share their times; `lists` are the times by the file's name."""
    merged = {name: times for name, times in lists.items() if _is_merged(times)}
    if not merged:
        return
    times = list(merged.values())[-1]
    most = len(np.unique(np.concatenate(list(merged.values()))))
    files = " and ".join(filter(None, [", ".join(list(merged)[:-1]), list(merged)[-1]]))
    if most == 1:
        raise InvalidScanError(f"All rows of {files} have the time {shown(times[0])}: print more digits.")
    values, counts = np.unique(times, return_counts=True)
    raise InvalidScanError(
        f"The rows of {files} share their times, {counts.max()} of {len(times)} have {shown(values[counts.argmax()])}: "
        "print more digits."
    )


def _is_merged(times: Times) -> bool:
    return len(times) > 1 and len(np.unique(times)) < OPTIONS.min_distinct_ratio * len(times)


def shown(time: float) -> str:
    """Return a time as it is read best: all digits before the point, up to six after it."""
    return f"{time:.6f}".rstrip("0").rstrip(".")


def range_in_words(name: str, times: Times) -> str:
    """Return a sentence's part that says from when to when a list runs."""
    return f"{name} runs from {shown(float(times.min()))} to {shown(float(times.max()))} s"
