"""How much freed memory the process keeps for its threads, and what its garbage collector looks at."""

from __future__ import annotations

import ctypes
import gc
from contextlib import suppress

# Parameter of mallopt(3) of glibc: the largest number of arenas.
M_ARENA_MAX = -8


def share_arenas(threads: int) -> bool:
    """Let the C library keep one arena of memory for each of some busy threads and one for all others.

    By default it has up to eight for each core. Each thread that answers something large now and then would keep, in an
    arena of its own, what that took at most. Returns whether the C library takes that, as glibc does.
    """
    with suppress(OSError, AttributeError):
        return bool(ctypes.CDLL(None).mallopt(M_ARENA_MAX, threads + 1))
    return False


def freeze_loaded() -> None:
    """Take all objects that are there now out of the garbage collector's sight.

    Modules, routes and models stay until the process ends. The collector would look at all of them again whenever it
    collects the oldest generation, and every request waits for that: a tenth of a second or two.
    """
    gc.collect()
    gc.freeze()
