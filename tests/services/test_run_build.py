"""A build in this process: what it leaves when it is cancelled at the last moment, or breaks where nobody thought."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import pytest

from app.errors import CancelledBuildError, MapDamagedError
from app.jobs.handlers import handle_build
from app.services.builds import run_build as module
from app.services.builds.run_build import run_build
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.services.submit_build import submit_build, withdraw_build
from app.settings import Settings
from app.storage.builds import Build, claim_build, get_build
from app.storage.maps import list_maps
from app.storage.venues import create_venue
from tests.scenes import CAMERA_TEXT, View, scan_files, zipped


class AtStage:
    """Does something when a stage is reported, and never says that the build should stop."""

    def __init__(self, stage: str, action: Callable[[], object]) -> None:
        self._stage, self._action = stage, action

    def report(self, stage: str, done: int, total: int) -> None:
        if stage == self._stage and done == 0:
            self._action()


@pytest.fixture
def claimed(tmp_path: Path, views: list[View]) -> tuple[Resources, Build]:
    """A build that has been taken from the queue."""
    resources = Resources.open(Settings(_env_file=None, data_dir=tmp_path, open=True))
    with resources.database.write() as connection:
        create_venue(connection, "v", "V")
    submit_build(resources, "v", {"camera": CAMERA_TEXT}, io.BytesIO(zipped(scan_files(views[:4]))))
    with resources.database.write() as connection:
        build = claim_build(connection)
    assert build is not None
    return resources, build


def versions(resources: Resources) -> int:
    with resources.database.read() as connection:
        return len(list_maps(connection, "v"))


def test_a_build_stores_map_and_pictures(claimed: tuple[Resources, Build]) -> None:
    resources, build = claimed
    assert run_build(build, resources, MapLibrary(resources), AtStage("", lambda: None)) == 1
    assert versions(resources) == 1
    assert len(resources.blobs.digests()) > 3
    assert not list(resources.scratch_dir.iterdir())
    serving = MapLibrary(resources).active("v")
    assert serving is not None
    assert serving[0].second_look is not None


def test_a_map_that_cant_be_opened_is_replaced_but_not_extended(
    claimed: tuple[Resources, Build], views: list[View]
) -> None:
    resources, build = claimed
    nothing = AtStage("", lambda: None)
    run_build(build, resources, MapLibrary(resources), nothing)
    with resources.database.read() as connection:
        path = resources.blobs.local_path(list_maps(connection, "v")[0].artifact_blob)
    path.write_bytes(b"damaged" * 99)
    for mode in ("extend", "replace"):
        options = {"camera": CAMERA_TEXT, "mode": mode}
        submit_build(resources, "v", options, io.BytesIO(zipped(scan_files(views[:4]))))
        with resources.database.write() as connection:
            again = claim_build(connection)
        assert again is not None
        if mode == "extend":
            with pytest.raises(MapDamagedError):
                run_build(again, resources, MapLibrary(resources), nothing)
        else:
            assert run_build(again, resources, MapLibrary(resources), nothing) == 2


def test_a_cancellation_just_before_the_map_is_published_counts(claimed: tuple[Resources, Build]) -> None:
    resources, build = claimed
    late = AtStage("publish", lambda: withdraw_build(resources, build.id))
    with pytest.raises(CancelledBuildError):
        run_build(build, resources, MapLibrary(resources), late)
    assert versions(resources) == 0
    # The archive goes when the build is marked as ended, which is its handler's part.
    assert resources.blobs.digests() == {build.archive_blob}


def test_an_error_nobody_thought_of_fails_the_build_and_leaves_nothing(
    claimed: tuple[Resources, Build], monkeypatch: pytest.MonkeyPatch
) -> None:
    resources, build = claimed

    def full_disk(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module, "publish_map", full_disk)
    handle_build(build, resources, MapLibrary(resources))
    with resources.database.read() as connection:
        ended = get_build(connection, build.id)
    assert (ended.state, ended.error_code) == ("failed", "internal")
    assert ended.error is not None
    assert "No space left" in ended.error
    assert versions(resources) == 0
    assert resources.blobs.digests() == set()
    assert not list(resources.scratch_dir.iterdir())
