"""The owner of a shared build is killed: its helper takes the build over and makes nothing again."""

from __future__ import annotations

import signal
from pathlib import Path

from tests.jobs.test_leases import VENUE, site
from tests.scenes import View, scan_files, zipped
from tests.server import wait_for

SHARING = {"ROOMFIX_SHARE_BUILDS": "true", "ROOMFIX_WORKERS": "1"}


def test_a_helper_goes_on_with_what_both_have_made(tmp_path: Path, views: list[View]) -> None:
    with site(tmp_path, zipped(scan_files(views[:4])), None) as workers:
        workers.hold("describe")
        owner = workers.start(**SHARING)
        build = workers.submit()
        workers.wait_until_held()
        (tmp_path / "held").unlink()
        parts = tmp_path / "scratch" / f"{build}-parts"

        def made() -> dict[str, int]:
            return {path.name: path.stat().st_mtime_ns for path in parts.glob("*") if "." not in path.name}

        before = len(made())
        # Nothing holds the helper: it makes what is left, while the owner stands still.
        workers.start(**SHARING)
        wait_for(lambda: len(made()) > before + 10 and not list(parts.parent.glob(f"{build}-help-*")))
        left = made()
        workers.hold("store")
        owner.send_signal(signal.SIGKILL)
        owner.wait()
        workers.wait_until_held()
        again = workers.server.status(build)
        assert (again["state"], again["attempts"]) == ("running", 2)
        assert made() == left
        workers.release()
        assert workers.server.wait(build)["state"] == "succeeded"
        assert workers.server.client.get(f"/venues/{VENUE}/maps").json()[0]["version"] == 1
        assert not parts.exists()
