"""A cache of limited size that drops the entry that was used least recently."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from threading import Lock
from typing import Generic, TypeVar

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


@dataclass(slots=True)
class _Making:
    """The lock that lets one thread at a time make the value of a key, and the number of threads that need it."""

    lock: Lock = field(default_factory=Lock)
    users: int = 0


class LruCache(Generic[K, V]):
    """Values by key, at most `capacity` of them. Safe to share between threads.

    With `size_of` the capacity is a sum of sizes instead of a count, for example of bytes; a value's size is measured
    once, when it is put. The value that was put last is kept even when it alone is larger than the capacity, since it
    would be made anew at each use otherwise.
    """

    def __init__(self, capacity: int, size_of: Callable[[V], int] | None = None) -> None:
        if capacity < 1:
            raise ValueError("The capacity of a cache is 1 or more.")
        self._capacity = capacity
        self._size_of = size_of
        self._lock = Lock()
        self._entries: OrderedDict[K, tuple[V, int]] = OrderedDict()
        self._total = 0
        self._making: dict[K, _Making] = {}

    def get(self, key: K) -> V | None:
        """Return the value of a key and count that as a use; None when it is not there."""
        with self._lock:
            entry = self._entries.get(key)
            if entry is None:
                return None
            self._entries.move_to_end(key)
            return entry[0]

    def put(self, key: K, value: V) -> None:
        """Set the value of a key, and drop what no longer fits."""
        size = 1 if self._size_of is None else self._size_of(value)
        with self._lock:
            self._remove(key)
            self._entries[key] = (value, size)
            self._total += size
            while self._total > self._capacity and len(self._entries) > 1:
                self._remove(next(iter(self._entries)))

    def get_or_make(self, key: K, make: Callable[[], V]) -> V:
        """Return the value of a key, made by `make` when it is not there.

        Threads that ask for the same key meanwhile wait for that one value; other keys are not held up. What `make`
        raises goes to its caller, and the next caller tries again.
        """
        value = self.get(key)
        if value is not None:
            return value
        with self._lock:
            making = self._making.setdefault(key, _Making())
            making.users += 1
        try:
            with making.lock:
                value = self.get(key)
                if value is None:
                    value = make()
                    self.put(key, value)
                return value
        finally:
            with self._lock:
                making.users -= 1
                if making.users == 0:
                    del self._making[key]

    def drop(self, key: K) -> None:
        """Remove a key, if it is there."""
        with self._lock:
            self._remove(key)

    def __len__(self) -> int:
        with self._lock:
            return len(self._entries)

    @property
    def total(self) -> int:
        """The sum of the sizes of all values, or their number without `size_of`."""
        with self._lock:
            return self._total

    def _remove(self, key: K) -> None:
        entry = self._entries.pop(key, None)
        if entry is not None:
            self._total -= entry[1]
