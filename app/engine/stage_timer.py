"""How long each stage of a piece of work took, and whether its result is still wanted."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextvars import ContextVar

# Seconds on a clock that only goes forward; for durations.
clock_s = time.perf_counter
# Says whether somebody waits for the result of the work in this context; None where nobody asks.
IS_WANTED: ContextVar[Callable[[], bool] | None] = ContextVar("is_wanted", default=None)


class NotWantedError(Exception):
    """Nobody waits for the result any more: the work is given up between two stages."""


class StageTimer:
    """Milliseconds by stage; laps of one stage add up."""

    def __init__(self) -> None:
        self.milliseconds: dict[str, float] = {}
        self._started = self._last = clock_s()

    def lap(self, stage: str) -> None:
        """Add the time since the last lap to a stage; raises `NotWantedError` when nobody waits for the result."""
        is_wanted = IS_WANTED.get()
        if is_wanted is not None and not is_wanted():
            raise NotWantedError
        now = clock_s()
        self.milliseconds[stage] = self.milliseconds.get(stage, 0.0) + 1e3 * (now - self._last)
        self._last = now

    @property
    def seconds(self) -> dict[str, float]:
        """Seconds by stage, to the millisecond."""
        return {stage: round(1e-3 * value, 3) for stage, value in self.milliseconds.items()}

    @property
    def total_ms(self) -> float:
        """Milliseconds since the timer was made."""
        return 1e3 * (clock_s() - self._started)
