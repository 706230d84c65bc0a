"""Work that several workers do together: each call is made by one of them, and its result reaches all through a folder.

All of them make the same calls in the same order, since they run the same build. A worker that dies leaves what it has
made, and the next attempt at the build begins with it.
"""

from __future__ import annotations

import hashlib
import io
import logging
import os
import pickle
import threading
import time
import uuid
from collections.abc import Callable
from concurrent.futures import Executor, Future
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any, ParamSpec, TypeVar

from app.limits import limit

P = ParamSpec("P")
Result = TypeVar("Result")

# What reading a file may raise that a full disk or a lost connection has cut short.
UNREADABLE = (OSError, EOFError, ValueError, TypeError, AttributeError, ImportError, pickle.UnpicklingError)
log = logging.getLogger("roomfix.builds")


@dataclass(frozen=True, slots=True, kw_only=True)
class SharedWorkOptions:
    """How calls are divided."""

    lease_s: float = limit(
        10.0,
        "Time after which a call that another worker began is made here too.",
        chosen="By hand: longer than nearly all calls. One that is made twice gives the same result twice.",
    )
    poll_s: float = limit(
        0.005,
        "Time between two checks for results of others.",
        chosen="By hand: a call takes some hundredths of a second.",
    )


OPTIONS = SharedWorkOptions()


@dataclass(frozen=True, slots=True)
class _Call:
    """A call, its future, and the name of its files, the same in all workers."""

    name: str
    function: Callable[..., Any]
    args: tuple[Any, ...]
    future: Future[Any]


class SharedExecutor(Executor):
    """Makes the calls of one build in threads, together with the executors of other workers on the same folder.

    `root` is the folder of this worker's own files: a path in it reaches the others as the path in theirs. A result
    that can't be stored is not shared. Calls are submitted by one thread.
    """

    def __init__(self, folder: Path, root: Path, threads: int, options: SharedWorkOptions = OPTIONS) -> None:
        self._folder, self._root, self._options = folder, root, options
        self._calls = 0
        self._basis = hashlib.sha256()
        self._todo: list[_Call] = []
        self._seen_s: dict[str, float] = {}
        self._changed = threading.Condition()
        self._is_closed = False
        self._threads = [
            threading.Thread(target=self._work, name=f"shared_{number}", daemon=True)
            for number in range(threads)
        ]
        for thread in self._threads:
            thread.start()

    def depend_on(self, *values: object) -> None:
        """State what the results of all later calls depend on, besides their arguments and the results before.

        Results of a worker that has stated something else are not used.
        """
        self._basis.update(repr(values).encode())

    def submit(self, fn: Callable[P, Result], /, *args: P.args, **kwargs: P.kwargs) -> Future[Result]:
        """Return the future of a call."""
        future: Future[Result] = Future()
        with self._changed:
            if self._is_closed:
                raise RuntimeError("The executor is closed.")
            name = self._name(fn, args)
            self._todo.append(_Call(name, partial(fn, **kwargs) if kwargs else fn, args, future))
            self._calls += 1
            self._changed.notify()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the threads once all calls are made, or with `cancel_futures` once those are that have begun."""
        with self._changed:
            self._is_closed = True
            if cancel_futures:
                for call in self._todo:
                    call.future.cancel()
                self._todo.clear()
            self._changed.notify_all()
        for thread in self._threads if wait else ():
            thread.join()

    def _name(self, function: Callable[..., Any], args: tuple[Any, ...]) -> str:
        inner = function.func if isinstance(function, partial) else function
        # Arguments of other types depend on what is in the basis already.
        plain = [repr(each) for each in args if isinstance(each, int | str | slice)]
        digest = self._basis.copy()
        digest.update(repr((getattr(inner, "__qualname__", ""), plain)).encode())
        return f"{self._calls:07d}-{digest.hexdigest()[:24]}"

    def _work(self) -> None:
        while True:
            with self._changed:
                chosen = self._choose()
                while chosen is None:
                    if self._is_closed and not self._todo:
                        return
                    self._changed.wait(self._options.poll_s if self._todo else None)
                    chosen = self._choose()
            call, is_made = chosen
            if not (is_made and self._load(call)):
                self._make(call)

    def _choose(self) -> tuple[_Call, bool] | None:
        """Take the first call whose result is there, or that nobody makes; return whether its result is there."""
        for call in [*self._todo]:
            is_made = self._result(call).exists()
            if is_made or call.future.cancelled() or self._claim(call):
                self._todo.remove(call)
                if call.future.set_running_or_notify_cancel():
                    return call, is_made
        return None

    def _claim(self, call: _Call) -> bool:
        """Return whether this worker is to make a call."""
        lease = self._lease(call)
        try:
            os.close(os.open(lease, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
        except FileExistsError:
            since = self._seen_s.setdefault(call.name, time.monotonic())
            return time.monotonic() - since > self._options.lease_s
        except OSError:
            # The build has ended elsewhere and its folder is gone, or the disk is full.
            return True
        return True

    def _make(self, call: _Call) -> None:
        try:
            result = call.function(*call.args)
        except BaseException as error:
            self._lease(call).unlink(missing_ok=True)
            call.future.set_exception(error)
            return
        try:
            self._store(call, result)
        except (OSError, pickle.PicklingError, TypeError, AttributeError) as error:
            log.debug("a result of %s is not shared: %s", call.name, error)
            self._lease(call).unlink(missing_ok=True)
        call.future.set_result(result)

    def _store(self, call: _Call, result: object) -> None:
        packed = io.BytesIO()
        _Pickler(packed, self._root).dump(result)
        part = self._folder / f"{call.name}.{uuid.uuid4().hex}"
        try:
            part.write_bytes(packed.getbuffer())
            part.replace(self._result(call))
        finally:
            part.unlink(missing_ok=True)

    def _load(self, call: _Call) -> bool:
        """Give a call the result that is stored; return False when that can't be read."""
        result: tuple[Any] | None = None
        with suppress(*UNREADABLE), self._result(call).open("rb") as file:
            result = (_Unpickler(file, self._root).load(),)
        if result is None:
            return False
        call.future.set_result(result[0])
        return True

    def _result(self, call: _Call) -> Path:
        return self._folder / call.name

    def _lease(self, call: _Call) -> Path:
        return self._folder / f"{call.name}.lease"


class _Pickler(pickle.Pickler):
    """Writes paths in a folder as paths relative to it."""

    def __init__(self, file: io.BytesIO, root: Path) -> None:
        super().__init__(file, protocol=5)
        self._root = root

    def persistent_id(self, obj: object) -> str | None:
        """Return the path within the folder, None for all other objects."""
        if isinstance(obj, Path) and obj.is_relative_to(self._root):
            return obj.relative_to(self._root).as_posix()
        return None


class _Unpickler(pickle.Unpickler):
    """Reads what a worker of this installation has written to the scratch folder, which nobody else writes to."""

    def __init__(self, file: Any, root: Path) -> None:
        super().__init__(file)
        self._root = root

    def persistent_load(self, pid: str) -> Path:
        """Return the path in this worker's folder."""
        return self._root / PurePosixPath(pid)
