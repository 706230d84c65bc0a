"""Kills at random moments while clients work, and what was lost by them. Every moment comes from a seed."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import threading
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import httpx

from app.storage.blobs import BlobStore
from app.storage.check import check_store
from app.storage.db import Database
from bench.kills.checking import Place, check, pages
from bench.kills.clients import FLOOR, TIMEOUT_S, VENUE, Acknowledged, Client, Sent
from bench.server_process import start_server, wait_until_ready

# From the start of the work until the kill.
MOST_S = 4.0
# After it, with one of two servers, or with a new worker.
AFTER_S = 1.0
WORKER = b"app.jobs.worker"
# Sessions outlive the longest run: one that expires has not been lost.
SESSION_TIMEOUT_S = 1e6


@dataclass(frozen=True, slots=True, kw_only=True)
class Site:
    """Where it happens: servers, each with its worker, on one data folder, and where their logs go. SQLite without a
    URL."""

    data_dir: Path
    logs: Path
    servers: int
    database_url: str | None


@dataclass(slots=True, kw_only=True)
class Outcome:
    """What happened: kills of a server and of a worker, what was acknowledged, where the picture was located, servers
    that were started again, acknowledged builds by their state, and what was wrong after which kill."""

    kills: Counter[str] = field(default_factory=Counter)
    kept: Acknowledged = field(default_factory=Acknowledged)
    place: Place = field(default_factory=Place)
    starts: int = 0
    builds: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True, kw_only=True)
class Process:
    """A server."""

    process: subprocess.Popen[bytes]
    url: str
    log: Path


def run_kills(site: Site, sent: Sent, seed: int, is_enough: Callable[[int], bool]) -> Outcome:
    """Kill a server or its worker again and again until `is_enough` of the number of kills, and check each time."""
    outcome, number = Outcome(), 0
    with serving(site) as processes:
        _prepare(processes[0])
        while True:
            _check(site, processes[-1], sent, outcome, number)
            if is_enough(number):
                return outcome
            _kill(processes, sent, outcome, number, random.Random(f"{seed} {site.servers} {number}"))
            outcome.starts += start_missing(site, processes)
            number += 1


@contextmanager
def serving(site: Site) -> Iterator[list[Process]]:
    """Start the servers and wait until they are ready; kill them in the end."""
    processes: list[Process] = []
    try:
        start_missing(site, processes)
        yield processes
    finally:
        for each in processes:
            each.process.kill()
            each.process.wait()


def start_missing(site: Site, processes: list[Process]) -> int:
    """Start servers in place of those that have ended; return their number once they are ready."""
    settings = {"ROOMFIX_RUN_WORKER": "true", "ROOMFIX_SESSION_TIMEOUT_S": str(SESSION_TIMEOUT_S)}
    settings |= {} if site.database_url is None else {"ROOMFIX_DATABASE_URL": site.database_url}
    alive = [each for each in processes if each.process.poll() is None]
    started = []
    for _ in range(site.servers - len(alive)):
        log = site.logs / uuid.uuid4().hex
        process, url = start_server(site.data_dir, log, **settings)
        started.append(Process(process=process, url=url, log=log))
    processes[:] = [*alive, *started]
    for each in started:
        wait_until_ready(each.url, each.process, each.log)
    return len(started)


def _prepare(server: Process) -> None:
    with httpx.Client(base_url=server.url, timeout=TIMEOUT_S, trust_env=False) as client:
        client.post("/venues", json={"id": VENUE, "name": VENUE}).raise_for_status()
        client.put(f"/venues/{VENUE}/floors/0", json=FLOOR).raise_for_status()


def _check(site: Site, server: Process, sent: Sent, outcome: Outcome, number: int) -> None:
    with httpx.Client(base_url=server.url, timeout=TIMEOUT_S, trust_env=False) as client:
        wrong = check(client, outcome.kept, sent, outcome.place)
        builds = pages(client, "/database/builds")
    states = (each["state"] for each in builds if each["build"] in outcome.kept.builds)
    outcome.builds = Counter(states)
    database = Database(site.database_url or f"sqlite:///{site.data_dir / 'roomfix.db'}")
    try:
        blobs = BlobStore.open(None, site.data_dir, site.data_dir / "cache")
        wrong += [str(finding) for finding in check_store(database, blobs, lambda *_: None).findings]
    finally:
        database.close()
    outcome.wrong += [f"after kill {number}: {each}" for each in wrong]


def _kill(processes: list[Process], sent: Sent, outcome: Outcome, number: int, rng: random.Random) -> None:
    is_over = threading.Event()
    clients = [
        Client(each.url, outcome.kept, sent, len(processes) * number + place, is_over)
        for place, each in enumerate(processes)
    ]
    for client in clients:
        client.start()
    time.sleep(rng.uniform(0.0, MOST_S))
    outcome.kills[_kill_one(rng.choice(processes).process, rng)] += 1
    time.sleep(rng.uniform(0.0, AFTER_S))
    is_over.set()
    for client in clients:
        client.join()


def _kill_one(process: subprocess.Popen[bytes], rng: random.Random) -> str:
    """Kill a server, or its worker; return which."""
    workers = [pid for pid in children(process.pid) if _is_worker(pid)]
    if workers and rng.random() < 0.5:
        with suppress(ProcessLookupError):
            os.kill(workers[0], signal.SIGKILL)
        return "worker"
    process.kill()
    process.wait()
    return "server"


def children(pid: int) -> list[int]:
    """Return the processes that a process has started (Linux)."""
    with suppress(OSError):
        return [int(each) for each in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    return []


def _is_worker(pid: int) -> bool:
    with suppress(OSError):
        return WORKER in Path(f"/proc/{pid}/cmdline").read_bytes()
    return False
