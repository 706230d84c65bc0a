"""How often a key may be used from an address, and how many wrong keys an address may try."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

from limits import RateLimitItemPerMinute
from limits.storage import MemoryStorage
from limits.strategies import SlidingWindowCounterRateLimiter

from app.errors import RateLimitError

CALLS = "calls"
WRONG_KEYS = "wrong-keys"
WINDOW_S = 60


@dataclass(frozen=True, slots=True)
class Usage:
    """How much of a limit is left, and after how many seconds it is renewed."""

    limit: int
    remaining: int
    reset_s: int

    def headers(self) -> dict[str, str]:
        """Return the RateLimit headers (draft-ietf-httpapi-ratelimit-headers)."""
        return {
            "RateLimit-Policy": f'"{CALLS}";q={self.limit};w={WINDOW_S}',
            "RateLimit": f'"{CALLS}";r={self.remaining};t={self.reset_s}',
        }


class Throttle:
    """Counts in the memory of this process, over a sliding minute; a limit of 0 is none. Safe between threads."""

    def __init__(self, calls_per_minute: int, wrong_keys_per_minute: int) -> None:
        self._limiter = SlidingWindowCounterRateLimiter(MemoryStorage())
        self._calls = RateLimitItemPerMinute(calls_per_minute) if calls_per_minute else None
        self._wrong = RateLimitItemPerMinute(wrong_keys_per_minute) if wrong_keys_per_minute else None

    def check_address(self, address: str) -> None:
        """Raise `RateLimitError` for an address that has tried too many wrong keys: no key of it is looked at."""
        if self._wrong is not None and not self._limiter.test(self._wrong, WRONG_KEYS, address):
            raise RateLimitError(
                "This address has sent too many wrong keys; wait before the next call.",
                self._usage(self._wrong, WRONG_KEYS, address).reset_s,
            )

    def note_wrong_key(self, address: str) -> None:
        """Count a wrong key of an address."""
        if self._wrong is not None:
            self._limiter.hit(self._wrong, WRONG_KEYS, address)

    def take(self, key: str, address: str) -> Usage | None:
        """Count a call with a key from an address and return what is left of the limit, None where there is none;
        raises `RateLimitError` when nothing was left."""
        if self._calls is None:
            return None
        is_taken = self._limiter.hit(self._calls, CALLS, key, address)
        usage = self._usage(self._calls, CALLS, key, address)
        if not is_taken:
            raise RateLimitError(
                f"This key made more than {usage.limit} calls in a minute from this address.", usage.reset_s
            )
        return usage

    def _usage(self, item: RateLimitItemPerMinute, *names: str) -> Usage:
        stats = self._limiter.get_window_stats(item, *names)
        return Usage(item.amount, stats.remaining, max(1, math.ceil(stats.reset_time - time.time())))
