"""How much memory that was freed the process keeps for its threads."""

from __future__ import annotations

import ctypes
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
