"""The embedded runner: one worker process beside the server, started again whenever it dies."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import threading
from collections.abc import Sequence
from contextlib import suppress

from app.settings import Settings

log = logging.getLogger("roomfix.jobs")
RESTART_DELAY_S = 1.0
STOP_TIMEOUT_S = 10.0

WORKER_COMMAND = (sys.executable, "-m", "app.jobs.worker")


class EmbeddedRunner:
    """Supervises the worker. The worker lives as long as the pipe to its standard input: a server that is killed
    takes it along."""

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
        """Tell the worker to look into the queue now."""
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
        """Stop the worker; what it was building is queued again when the next one starts."""
        self._stopping.set()
        process = self._process
        if process is not None:
            process.terminate()
            try:
                process.wait(STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        if self._thread is not None:
            self._thread.join(STOP_TIMEOUT_S)

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
            self._stopping.wait(RESTART_DELAY_S)
            if not self._stopping.is_set():
                self._process = self._spawn()
            # `stop` may have looked at the old process while the new one was being started.
            if self._stopping.is_set() and self.alive() and self._process is not None:
                self._process.kill()


def _environment(settings: Settings) -> dict[str, str]:
    """Return the settings as the environment of the worker, which may have come from the command line here."""
    values = settings.model_dump(mode="json", exclude={"admin_key"})
    values["data_dir"] = str(settings.data_dir.resolve())
    return {f"ROOMFIX_{name.upper()}": str(value) for name, value in values.items() if value is not None}
