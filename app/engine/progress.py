"""How long work reports where it is, and learns that it should stop."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from contextlib import suppress
from typing import Protocol, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


class Progress(Protocol):
    """Takes the stage and how much of it is done; raises `CancelledBuildError` when the work should stop."""

    def report(self, stage: str, done: int, total: int) -> None:
        """Note that `done` of `total` steps of a stage are done."""
        ...


class NoProgress:
    """Ignores everything."""

    def report(self, stage: str, done: int, total: int) -> None:
        """Ignore the report."""


def map_in_order(
    executor: Executor,
    function: Callable[[Item], Result],
    items: Iterable[Item],
    stage: str,
    progress: Progress,
    window: int = 16,
) -> Iterator[Result]:
    """Yield `function(item)` in order, computed by the executor, at most `window` ahead, reporting each one."""
    todo = list(items)
    waiting: list[Future[Result]] = []
    progress.report(stage, 0, len(todo))
    try:
        for done, item in enumerate(todo):
            waiting.append(executor.submit(function, item))
            if len(waiting) >= window:
                yield waiting.pop(0).result()
                progress.report(stage, done + 2 - window, len(todo))
        while waiting:
            yield waiting.pop(0).result()
            progress.report(stage, len(todo) - len(waiting), len(todo))
    finally:
        for future in waiting:
            future.cancel()
        for future in waiting:
            with suppress(Exception):
                future.exception()
