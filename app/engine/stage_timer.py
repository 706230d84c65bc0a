"""How long each stage of a piece of work took."""

from __future__ import annotations

import time

# Seconds on a clock that only goes forward; for durations.
clock_s = time.perf_counter


class StageTimer:
    """Milliseconds by stage; laps of one stage add up."""

    def __init__(self) -> None:
        self.milliseconds: dict[str, float] = {}
        self._started = self._last = clock_s()

    def lap(self, stage: str) -> None:
        """Add the time since the last lap to a stage."""
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
