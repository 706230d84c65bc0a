"""Calls that several executors make together through a folder."""

from __future__ import annotations

import threading
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from app.engine.progress import NoProgress, map_in_order
from app.services.builds.shared_work import SharedExecutor, SharedWorkOptions

CALLS = 60


@dataclass(frozen=True)
class Seen:
    """A result with a path and an array."""

    path: Path
    values: np.ndarray


class Worker:
    """One of the workers of a build: its executor, its own folder, and the calls that it has made itself."""

    def __init__(self, shared: Path, own: Path, lease_s: float = 60.0) -> None:
        self.own, self.made = own, list[int]()
        self.executor = SharedExecutor(shared, own, 1, SharedWorkOptions(lease_s=lease_s))

    def run(self, meeting: threading.Barrier | None = None) -> list[Seen]:
        def call(number: int) -> Seen:
            self.made.append(number)
            if meeting is not None and number in (0, 1):
                # Goes on only once the other worker makes the other call.
                meeting.wait(30)
            return Seen(self.own / "scan" / f"{number}.png", np.full(3, number / 7))

        try:
            return list(map_in_order(self.executor, call, range(CALLS), "test", NoProgress()))
        finally:
            self.executor.shutdown(cancel_futures=True)


@pytest.fixture
def shared(tmp_path: Path) -> Path:
    (tmp_path / "parts").mkdir()
    return tmp_path / "parts"


def check(found: list[Seen], own: Path) -> None:
    assert [each.path for each in found] == [own / "scan" / f"{number}.png" for number in range(CALLS)]
    assert all(np.array_equal(each.values, np.full(3, number / 7)) for number, each in enumerate(found))


def test_each_call_is_made_by_one_of_two(shared: Path, tmp_path: Path) -> None:
    workers = [Worker(shared, tmp_path / name) for name in "ab"]
    meeting, results = threading.Barrier(2), dict[int, list[Seen]]()
    threads = [
        threading.Thread(target=lambda n=n: results.update({n: workers[n].run(meeting)})) for n in (0, 1)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(workers[0].made + workers[1].made) == list(range(CALLS))
    for worker, found in zip(workers, (results[0], results[1]), strict=True):
        assert {0, 1} & set(worker.made)
        check(found, worker.own)


def test_what_a_dead_worker_has_made_is_not_made_again(shared: Path, tmp_path: Path) -> None:
    Worker(shared, tmp_path / "a").run()
    again = Worker(shared, tmp_path / "b")
    check(again.run(), again.own)
    assert again.made == []


def test_calls_of_a_dead_worker_and_results_that_are_cut_short_are_made(shared: Path, tmp_path: Path) -> None:
    Worker(shared, tmp_path / "a").run()
    results = sorted(path for path in shared.iterdir() if path.suffix != ".lease")
    assert len(results) == CALLS
    results[5].unlink()
    results[9].write_bytes(results[9].read_bytes()[:40])
    results[11].write_bytes(b"")
    again = Worker(shared, tmp_path / "b", lease_s=0.0)
    check(again.run(), again.own)
    assert sorted(again.made) == [5, 9, 11]


def test_results_that_depend_on_something_else_are_not_used(shared: Path, tmp_path: Path) -> None:
    Worker(shared, tmp_path / "a").run()
    other = Worker(shared, tmp_path / "b")
    other.executor.depend_on("another map")
    check(other.run(), other.own)
    assert other.made == list(range(CALLS))


def test_what_cant_be_stored_is_not_shared_and_errors_are_raised(shared: Path, tmp_path: Path) -> None:
    for name in "ab":
        executor = SharedExecutor(shared, tmp_path / name, 2)
        lock, error = threading.Lock(), ValueError("broken")

        def fails(_: int, error: ValueError = error) -> None:
            raise error

        unshared: Future[threading.Lock] = executor.submit(lambda _, lock=lock: lock, 1)
        broken = executor.submit(fails, 2)
        assert unshared.result(30) is lock
        assert broken.exception(30) is error
        executor.shutdown()
    assert not [path for path in shared.iterdir() if path.suffix != ".lease"]


def test_a_folder_that_is_gone_stops_nobody(shared: Path, tmp_path: Path) -> None:
    shared.rmdir()
    alone = Worker(shared, tmp_path / "a")
    check(alone.run(), alone.own)
    assert alone.made == list(range(CALLS))


def test_calls_that_are_cancelled_are_not_made(shared: Path, tmp_path: Path) -> None:
    executor = SharedExecutor(shared, tmp_path / "a", 1)
    begun, go_on = threading.Event(), threading.Event()
    made: list[int] = []

    def call(number: int) -> int:
        made.append(number)
        begun.set()
        go_on.wait(30)
        return number

    futures = [executor.submit(call, number) for number in range(5)]
    begun.wait(30)
    assert futures[3].cancel()
    go_on.set()
    assert [each.result(30) for each in futures if each is not futures[3]] == [0, 1, 2, 4]
    executor.shutdown()
    assert made == [0, 1, 2, 4]
    with pytest.raises(RuntimeError):
        executor.submit(call, 9)
