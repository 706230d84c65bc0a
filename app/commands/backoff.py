"""Growing pauses between attempts to reach something that has failed."""

from __future__ import annotations

import random
from dataclasses import dataclass

from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class BackoffOptions:
    """How long to wait before the next attempt."""

    first_s: float = limit(
        1.0,
        "Pause after the first failure; each further failure doubles it.",
        chosen="By hand: a restart is over.",
    )
    max_s: float = limit(
        60.0,
        "Longest pause.",
        chosen="By hand: somebody who repairs a camera or server doesn't wait longer to see it work.",
    )
    spread_ratio: float = limit(
        0.3,
        "Random part of a pause, in both directions.",
        chosen="By hand: it keeps many cameras from returning at the same moment.",
    )


OPTIONS = BackoffOptions()


class Backoff:
    """Gives the pause before each attempt, until one succeeds."""

    def __init__(self) -> None:
        self._wait_s = OPTIONS.first_s

    def next_pause_s(self) -> float:
        """Return the seconds to wait after one more failure."""
        pause_s = self._wait_s * random.uniform(1.0 - OPTIONS.spread_ratio, 1.0 + OPTIONS.spread_ratio)
        self._wait_s = min(2.0 * self._wait_s, OPTIONS.max_s)
        return pause_s

    def reset(self) -> None:
        """Begin with the first pause again, after a success."""
        self._wait_s = OPTIONS.first_s
