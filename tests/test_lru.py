"""The bounded cache: what it keeps, what it drops, and that one value is made once."""

from __future__ import annotations

import threading

import pytest

from app.lru import LruCache


def test_the_entry_used_least_recently_is_dropped() -> None:
    cache: LruCache[str, int] = LruCache(2)
    cache.put("a", 1)
    cache.put("b", 2)
    assert cache.get("a") == 1
    cache.put("c", 3)
    assert [cache.get(key) for key in "abc"] == [1, None, 3]
    assert len(cache) == 2


def test_a_size_function_bounds_the_sum_of_sizes() -> None:
    cache: LruCache[str, bytes] = LruCache(10, len)
    cache.put("a", b"4444")
    cache.put("b", b"55555")
    assert cache.total == 9
    cache.put("c", b"22")
    assert [cache.get(key) is not None for key in "abc"] == [False, True, True]
    assert cache.total == 7


def test_a_replaced_value_counts_once() -> None:
    cache: LruCache[str, bytes] = LruCache(10, len)
    for size in (8, 3, 9):
        cache.put("a", bytes(size))
    assert (len(cache), cache.total) == (1, 9)


def test_a_value_above_the_capacity_is_kept_alone() -> None:
    cache: LruCache[str, bytes] = LruCache(10, len)
    cache.put("small", b"1")
    cache.put("large", bytes(50))
    assert cache.get("large") == bytes(50)
    assert cache.get("small") is None
    cache.put("small", b"1")
    assert (cache.get("large"), cache.total) == (None, 1)


def test_a_dropped_key_is_made_again() -> None:
    cache: LruCache[str, list[int]] = LruCache(2)
    first = cache.get_or_make("a", list)
    assert cache.get_or_make("a", list) is first
    cache.drop("a")
    cache.drop("never there")
    assert cache.total == 0
    assert cache.get_or_make("a", list) is not first


def test_threads_that_ask_for_one_key_share_one_value() -> None:
    cache: LruCache[str, list[int]] = LruCache(2)
    made: list[list[int]] = []
    begun, may_end = threading.Event(), threading.Event()

    def make() -> list[int]:
        begun.set()
        assert may_end.wait(10)
        made.append([])
        return made[-1]

    found: list[list[int]] = []
    threads = [
        threading.Thread(target=lambda: found.append(cache.get_or_make("slow", make))) for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    assert begun.wait(10)
    # Another key is not held up by the one that is being made.
    assert cache.get_or_make("other", lambda: [1]) == [1]
    may_end.set()
    for thread in threads:
        thread.join()
    assert len(made) == 1
    assert [value is made[0] for value in found] == [True] * 4


def test_after_a_failure_the_next_caller_tries_again() -> None:
    cache: LruCache[str, int] = LruCache(2)

    def fail() -> int:
        raise OSError("no such file")

    for _ in range(2):
        with pytest.raises(OSError, match="no such file"):
            cache.get_or_make("a", fail)
    assert cache.get_or_make("a", lambda: 5) == 5


def test_a_cache_that_could_hold_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="capacity"):
        LruCache(0)
