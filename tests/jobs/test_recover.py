"""What happens to the builds of workers that have died."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.jobs.handlers import recover
from app.jobs.lease import LeaseWatch
from app.jobs.worker_name import worker_name
from app.services.builds.run_build import scratch_folder
from app.services.resources import Resources
from app.settings import Settings
from app.storage.builds import claim_build, create_build, get_build
from app.storage.venues import create_venue


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
def test_only_the_dead_attempt_s_scratch_folder_is_removed(tmp_path: Path) -> None:
    """The next attempt may have begun, in another worker, before the folder of the dead one is removed."""
    resources = Resources.open(Settings(_env_file=None, data_dir=tmp_path, open=True))  # type: ignore[call-arg]
    # The process id of this test, as it was taken by another process before.
    machine, pid, _, rest = worker_name().split("/")
    with resources.database.write() as connection:
        venue = create_venue(connection, "v", "V").id
        build_id = create_build(connection, venue, {}, "a" * 64)
        dead = claim_build(connection, f"{machine}/{pid}/1/{rest}")
    assert dead is not None
    assert dead.attempts == 1
    left = scratch_folder(resources, dead)
    left.mkdir()
    next_one = left.with_name(f"{build_id}-2")
    next_one.mkdir()
    recover(resources, LeaseWatch())
    assert (left.exists(), next_one.exists()) == (False, True)
    with resources.database.read() as connection:
        assert get_build(connection, build_id).state == "queued"
    resources.close()
