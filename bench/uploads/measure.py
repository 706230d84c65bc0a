"""What an upload over a breaking connection takes of a server: memory, disk, time."""

from __future__ import annotations

import hashlib
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx

from app.commands.uploads.client import OPTIONS, begin_upload, send_file
from app.errors import RoomfixError
from bench.uploads.cutting_proxy import cutting_proxy

SAMPLE_S = 0.05
VENUE = "upload-bench"
BLOCK_BYTES = 1_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class UploadCost:
    """What an upload took."""

    megabytes: float
    cuts: int
    seconds: float
    is_whole: bool
    memory_above_idle_mb: float
    disk_ratio: float


def make_file(path: Path, megabytes: int) -> str:
    """Write a file that doesn't compress and return its SHA-256."""
    hasher = hashlib.sha256()
    with path.open("wb") as file:
        for _ in range(megabytes):
            block = os.urandom(BLOCK_BYTES)
            hasher.update(block)
            file.write(block)
    return hasher.hexdigest()


def measure_upload(
    server_url: str, pid: int, data_dir: Path, file: Path, digest: str, cuts: int
) -> UploadCost:
    """Send a file to a server on this machine through a proxy that breaks the connection, and queue its build.

    `pid` is the server's process, `data_dir` its data folder; disk is what the folder takes beside the blobs.
    """
    length = file.stat().st_size
    with httpx.Client(base_url=server_url, timeout=60.0) as plain:
        if plain.get(f"/venues/{VENUE}").status_code == 404:
            plain.post("/venues", json={"id": VENUE, "name": VENUE})
        began = time.perf_counter()
        with (
            watched(pid, data_dir) as peak,
            cutting_proxy(server_url, length, cuts) as proxy,
            httpx.Client(base_url=proxy.url, timeout=OPTIONS.timeout_s) as client,
        ):
            url = begin_upload(client, length, VENUE)
            send_file(client, url, file, pause=lambda _: time.sleep(SAMPLE_S))
            form = {"venue": VENUE, "upload": url.rsplit("/", 1)[-1]}
            answer = plain.post("/database/build", data=form, timeout=600.0)
        seconds = time.perf_counter() - began
    if answer.status_code != 202:
        raise RoomfixError(f"The build was refused: {answer.text}")
    return UploadCost(
        megabytes=length / 1e6,
        cuts=proxy.cuts,
        seconds=seconds,
        is_whole=_stored_digest(data_dir, digest) == digest,
        memory_above_idle_mb=(peak.memory_bytes - peak.idle_bytes) / 1e6,
        disk_ratio=peak.disk_bytes / length,
    )


@dataclass(slots=True)
class Peak:
    """The largest values so far."""

    idle_bytes: int
    memory_bytes: int = 0
    disk_bytes: int = 0


@contextmanager
def watched(pid: int, data_dir: Path) -> Iterator[Peak]:
    """Watch a process's resident memory, and what a data folder takes beside its blobs."""
    peak, ended = Peak(resident_bytes(pid)), threading.Event()
    before = _beside_store_bytes(data_dir)

    def watch() -> None:
        while not ended.wait(SAMPLE_S):
            peak.memory_bytes = max(peak.memory_bytes, resident_bytes(pid))
            peak.disk_bytes = max(peak.disk_bytes, _beside_store_bytes(data_dir) - before)

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        yield peak
    finally:
        ended.set()
        thread.join()


def resident_bytes(pid: int) -> int:
    """Return the resident memory of a process (Linux)."""
    pages = Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


def _beside_store_bytes(data_dir: Path) -> int:
    total = 0
    for folder, names, files in os.walk(data_dir):
        if Path(folder) == data_dir and "blobs" in names:
            names.remove("blobs")
        for name in files:
            try:
                total += 512 * Path(folder, name).stat().st_blocks
            except FileNotFoundError:
                continue
    return total


def _stored_digest(data_dir: Path, digest: str) -> str:
    found = next(iter((data_dir / "blobs").rglob(digest)), None)
    if found is None:
        return ""
    with found.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
