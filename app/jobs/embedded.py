"""The embedded runner: one worker process beside the server, started again whenever it dies."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import threading
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

from app.limits import limit
from app.settings import Settings

log = logging.getLogger("roomfix.jobs")
WORKER_COMMAND = (sys.executable, "-m", "app.jobs.worker")


@dataclass(frozen=True, slots=True, kw_only=True)
class SupervisionOptions:
    """How the worker process is started again and stopped."""

    restart_delay_s: float = limit(
        1.0,
        "Pause before a worker that died is started again.",
        chosen="By hand: a worker that dies at its start must not keep a core busy.",
    )
    stop_timeout_s: float = limit(
        10.0,
        "Time that a worker has to end before it is killed.",
        chosen="By hand: it ends at once unless the system is stuck, and service managers wait longer than this.",
    )


OPTIONS = SupervisionOptions()


class EmbeddedRunner:
    """Supervises the worker process. The worker ends when the pipe to its standard input closes, so that it never
    outlives a server that was killed."""

    def __init__(self, settings: Settings, command: Sequence[str] = WORKER_COMMAND) -> None:
        self._settings = settings
        self._command = list(command)
        self._process: subprocess.Popen[bytes] | None = None
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Start the worker and the thread that watches it."""
        self._process = self._spawn()
        self._thread = threading.Thread(target=self._supervise, name="build-worker-watch", daemon=True)
        self._thread.start()

    def wake(self) -> None:
        """Make the worker check the queue now."""
        process = self._process
        if process is not None and process.stdin is not None:
            with suppress(OSError, ValueError):
                process.stdin.write(b"\n")
                process.stdin.flush()

    def alive(self) -> bool:
        """Return whether the worker runs."""
        return self._process is not None and self._process.poll() is None

    @property
    def pid(self) -> int | None:
        """The worker's process id."""
        return self._process.pid if self._process is not None else None

    def stop(self) -> None:
        """Stop the worker; what it has not finished building in the time for that is queued again."""
        self._stopping.set()
        process = self._process
        if process is not None:
            process.terminate()
            try:
                process.wait(OPTIONS.stop_timeout_s + self._settings.finish_build_s)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        if self._thread is not None:
            self._thread.join(OPTIONS.stop_timeout_s)

    def _spawn(self) -> subprocess.Popen[bytes]:
        environment = {**os.environ, **_environment(self._settings)}
        return subprocess.Popen(self._command, stdin=subprocess.PIPE, env=environment)  # noqa: S603

    def _supervise(self) -> None:
        while not self._stopping.is_set():
            process = self._process
            if process is not None:
                code = process.wait()
                if self._stopping.is_set():
                    return
                log.warning("the build worker ended with code %s; starting it again", code)
            self._stopping.wait(OPTIONS.restart_delay_s)
            if not self._stopping.is_set():
                self._process = self._spawn()
            # `stop` may have terminated the old process while the new one was being started.
            if self._stopping.is_set() and self.alive() and self._process is not None:
                self._process.kill()


def _environment(settings: Settings) -> dict[str, str]:
    """Return the settings as environment variables for the worker; some may come from the server's command line."""
    values = settings.model_dump(mode="json", exclude={"admin_key"})
    values["data_dir"] = str(settings.data_dir.resolve())
    return {f"ROOMFIX_{name.upper()}": str(value) for name, value in values.items() if value is not None}
