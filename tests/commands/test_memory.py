"""The arenas of memory that a server's threads share, and the objects that are not collected."""

from __future__ import annotations

import subprocess
import sys

import pytest

# Prints the number of arenas after many threads have allocated at the same time.
COUNT_ARENAS = """
import ctypes, sys, tempfile, threading
from app.commands.serving.memory import share_arenas
threads = int(sys.argv[1])
assert not threads or share_arenas(threads)
libc = ctypes.CDLL(None)
libc.malloc.restype, libc.fopen.restype = ctypes.c_void_p, ctypes.c_void_p
together = threading.Barrier(12)
def allocate():
    together.wait()
    libc.malloc(ctypes.c_size_t(1000))
    together.wait()
running = [threading.Thread(target=allocate) for _ in range(12)]
[each.start() for each in running]
[each.join() for each in running]
with tempfile.NamedTemporaryFile() as file:
    stream = ctypes.c_void_p(libc.fopen(file.name.encode(), b"w"))
    libc.malloc_info(0, stream)
    libc.fclose(stream)
    print(file.read().decode().count("<heap nr="))
"""


def arenas(threads: int) -> int:
    """Return the number of arenas of a process; with 0 its threads share none."""
    ended = subprocess.run(
        [sys.executable, "-c", COUNT_ARENAS, str(threads)], capture_output=True, text=True, check=True
    )
    return int(ended.stdout)


@pytest.mark.skipif(sys.platform != "linux", reason="arenas are of glibc")
def test_threads_share_arenas() -> None:
    assert arenas(2) == 3
    assert arenas(0) > 3


# Prints how many objects the collector has in sight before and after.
COUNT_OBJECTS = """
import gc
from app.commands.serving.memory import freeze_loaded
before = len(gc.get_objects())
freeze_loaded()
print(before, len(gc.get_objects()), gc.get_freeze_count())
"""


def test_what_is_loaded_is_not_looked_at_by_the_garbage_collector() -> None:
    ended = subprocess.run([sys.executable, "-c", COUNT_OBJECTS], capture_output=True, text=True, check=True)
    before, after, frozen = (int(number) for number in ended.stdout.split())
    assert after < 0.01 * before
    assert frozen > 0.5 * before
