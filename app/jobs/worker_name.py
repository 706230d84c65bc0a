"""Names of worker processes, by which another process of the same machine sees whether they live."""

from __future__ import annotations

import os
import socket
import uuid
from pathlib import Path

PROC = Path("/proc")


def worker_name() -> str:
    """Return a name of this process that no other one has or will have: machine, process id, start, a random part."""
    return f"{_machine()}/{os.getpid()}/{_started(os.getpid()) or ''}/{uuid.uuid4().hex[:12]}"


def is_surely_dead(name: str) -> bool:
    """Return whether a worker was a process of this machine that has ended; False when that can't be known."""
    machine, pid, started, *_ = [*name.split("/"), "", "", ""]
    if machine != _machine() or not pid.isdigit() or not started:
        return False
    return _started(int(pid)) != started


def _machine() -> str:
    """Return a name of this machine, its boot, and this namespace of process ids: each container has its own."""
    try:
        boot = (PROC / "sys/kernel/random/boot_id").read_text().strip()
        return f"{boot}:{(PROC / 'self/ns/pid').readlink()}"
    except OSError:
        return socket.gethostname().replace("/", "")


def _started(pid: int) -> str | None:
    """Return when a process started, in ticks since the boot; None when it has ended or that can't be known."""
    try:
        # After the name of the program, which may hold spaces: the state, and 19 fields later the start.
        fields = (PROC / str(pid) / "stat").read_text().rsplit(")", 1)[1].split()
    except (OSError, IndexError):
        return None
    return None if fields[0] in "ZX" else fields[19]
