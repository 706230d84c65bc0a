"""The build worker, held where a test wants it: at the stage that the file `hold` in the data folder names.

It waits there, having written `held`, until `hold` names another stage or is gone. Of the environment, `LOCK_WAIT_S`
shortens the time that a database, patient or not, waits for a lock, `LEASE_S` the time after which a silent worker
is given up, and `POLL_S` is the time between two checks of the queue. Started by its path, in place of
`python -m app.jobs.worker`.
"""

from __future__ import annotations

import os
import time
from pathlib import Path

from app.jobs import handlers, lease, worker
from app.storage import db

POLL_S = 0.01


class HeldProgress(handlers.BuildProgress):
    """Reports as ever, then waits if it is to be held at that stage."""

    def report(self, stage: str, done: int, total: int) -> None:
        """Report, wait, and report again: what happened in the meantime counts."""
        super().report(stage, done, total)
        if hold_at(stage):
            super().report(stage, done, total)


def hold_at(stage: str) -> bool:
    """Wait while the file names the stage; return whether it did."""
    folder = Path(os.environ["ROOMFIX_DATA_DIR"])
    hold, held = folder / "hold", folder / "held"
    if not _names(hold, stage):
        return False
    held.write_text(stage)
    while _names(hold, stage):
        time.sleep(POLL_S)
    held.unlink(missing_ok=True)
    return True


def _names(path: Path, stage: str) -> bool:
    try:
        return path.read_text() == stage
    except FileNotFoundError:
        return False


if __name__ == "__main__":
    if "LOCK_WAIT_S" in os.environ:
        wait_s = float(os.environ["LOCK_WAIT_S"])
        db.OPTIONS = db.DatabaseOptions(lock_wait_s=wait_s, patient_wait_s=wait_s)
    if "LEASE_S" in os.environ:
        lease.OPTIONS = lease.LeaseOptions(lease_s=float(os.environ["LEASE_S"]))
    if "POLL_S" in os.environ:
        worker.OPTIONS = worker.WorkerOptions(poll_s=float(os.environ["POLL_S"]))
    handlers.BuildProgress = HeldProgress  # type: ignore[misc]
    worker.main()
