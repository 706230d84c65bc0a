"""Builds that several workers make together: the map is the one that a worker makes alone."""

from __future__ import annotations

import io
import os
import shutil
import struct
import threading
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.engine.maps.artifact import MapArrays, MapArtifact
from app.engine.progress import NoProgress
from app.errors import CancelledBuildError
from app.jobs import sharing
from app.jobs.handlers import handle_build
from app.jobs.sharing import Helper, parts_folder, shared
from app.services.builds.run_build import linked_scan, make_map, scratch, scratch_folder, unpack
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.services.submit_build import submit_build, withdraw_build
from app.settings import Settings
from app.storage.builds import Build, claim_build, get_build
from app.storage.leases import hand_over
from app.storage.maps import get_map
from app.storage.venues import create_venue
from tests.scenes import CAMERA, CAMERA_TEXT, View, scan_files, zipped
from tests.server import WAIT_S

OWNER = "owner"


class Venue:
    """A data folder with a venue, and builds of one scan in it."""

    def __init__(self, folder: Path, views: list[View]) -> None:
        settings = Settings(_env_file=None, data_dir=folder, open=True, share_builds=True, workers=1)
        self.resources = Resources.open(settings)
        self.alone = replace(self.resources, settings=settings.model_copy(update={"share_builds": False}))
        self.scan = zipped(scan_files(views[:3]))
        with self.resources.database.write() as connection:
            create_venue(connection, "v", "V")

    def submit(self, **options: object) -> str:
        given = {"camera": CAMERA_TEXT, "gravity": [0, 1, 0], **options}
        return submit_build(self.resources, "v", given, io.BytesIO(self.scan))

    def claimed(self) -> Build:
        self.submit()
        return self.claim()

    def claim(self) -> Build:
        with self.resources.database.write() as connection:
            build = claim_build(connection, OWNER)
        assert build is not None
        return build

    def unpack(self, build: Build) -> None:
        """Unpack the scan as the owner does it."""
        unpack(build, self.resources, scratch_folder(self.resources, build), NoProgress())

    def ended(self, build: Build) -> Build:
        with self.resources.database.read() as connection:
            return get_build(connection, build.id)

    def run(self, build: Build, resources: Resources) -> MapArtifact:
        handle_build(build, resources, MapLibrary(resources))
        ended = self.ended(build)
        assert ended.map_version is not None, ended.error
        with self.resources.database.read() as connection:
            version = get_map(connection, "v", ended.map_version)
        return MapArtifact.open(self.resources.blobs.local_path(version.artifact_blob))


@pytest.fixture
def venue(tmp_path: Path, views: list[View]) -> Venue:
    return Venue(tmp_path, views)


def same(a: MapArtifact, b: MapArtifact) -> bool:
    arrays = (
        np.array_equal(getattr(a.arrays, name), getattr(b.arrays, name)) for name in MapArrays.__slots__
    )
    return a.metadata == b.metadata and all(arrays)


def test_a_map_made_of_parts_is_the_one_of_the_worker_that_made_them(venue: Venue) -> None:
    resources, build = venue.resources, venue.claimed()
    parts, folder = parts_folder(resources, build.id), resources.scratch_dir / "first"
    parts.mkdir()
    library = MapLibrary(resources)
    with sharing._sharing(resources, build.id, folder) as own, scratch(folder):
        alone = make_map(build, own, library, NoProgress(), folder)
    made = {path.name: path.stat().st_mtime_ns for path in parts.iterdir()}
    assert len(made) > 10
    # A helper, and then the owner, in folders of their own: they find all there is to do done.
    venue.unpack(build)
    helper = Helper(resources, library, threading.Event())
    assert helper.help_one()
    assert not helper.help_one()
    assert {path.name: path.stat().st_mtime_ns for path in parts.iterdir()} == made
    together = venue.run(build, resources)
    assert same(together, alone.check.stated_in(alone.built.artifact))
    assert not list(resources.scratch_dir.iterdir())


def sens_file(views: list[View]) -> bytes:
    """Return a recording whose pictures each worker takes out into files of its own."""
    K = np.eye(4, dtype="<f4")
    K[0, 0], K[1, 1], K[0, 2], K[1, 2] = CAMERA.params
    height, width = views[0].depth_m.shape
    parts = [struct.pack("<IQ", 4, 1), b"x", *(each.tobytes() for each in (K, np.eye(4, dtype="<f4")) * 2)]
    parts.append(struct.pack("<2i4IfQ", 2, 1, width, height, width, height, 1000.0, len(views)))
    for number, view in enumerate(views):
        color = view.jpeg()
        depth = zlib.compress(np.rint(1000 * view.depth_m).astype("<u2").tobytes())
        parts.append(view.world_from_camera.matrix.astype("<f4").tobytes())
        parts.append(struct.pack("<4Q", *[100_000 * number] * 2, len(color), len(depth)) + color + depth)
    return b"".join([*parts, struct.pack("<Q", 0)])


def test_frames_that_a_helper_took_out_of_a_recording_are_files_of_its_own(
    tmp_path: Path, views: list[View]
) -> None:
    venue = Venue(tmp_path, views)
    venue.scan = sens_file(views[:4])
    venue.submit(camera=None)
    build, resources = venue.claim(), venue.resources
    parts_folder(resources, build.id).mkdir()
    venue.unpack(build)
    assert Helper(resources, MapLibrary(resources), threading.Event()).help_one()
    made = len(list(parts_folder(resources, build.id).iterdir()))
    assert made > 10
    # Made of what the helper left, whose own files are gone.
    assert venue.run(build, resources).keyframe_count > 0


def test_a_helper_reads_the_files_that_the_owner_has_unpacked(
    venue: Venue, monkeypatch: pytest.MonkeyPatch
) -> None:
    build, own = venue.claimed(), venue.resources.scratch_dir / "own"
    unpacked = scratch_folder(venue.resources, build)
    own.mkdir()
    assert linked_scan(unpacked, own) is None
    venue.unpack(build)
    (unpacked / "unpacked").rename(unpacked / "unpacked.part")
    # All files are there, and nothing says so yet.
    assert linked_scan(unpacked, own) is None
    (unpacked / "unpacked.part").rename(unpacked / "unpacked")
    root = linked_scan(unpacked, own)
    assert root is not None
    assert (root / "rgb.txt").samefile(unpacked / "scan" / "rgb.txt")
    shutil.rmtree(unpacked)
    assert (root / "rgb.txt").read_text()
    # Where files can't be linked, as across two disks, the helper unpacks them itself.
    venue.unpack(build)
    parts_folder(venue.resources, build.id).mkdir()

    def refuse(*_: object, **__: object) -> None:
        raise OSError("Invalid cross-device link")

    monkeypatch.setattr(os, "link", refuse)
    assert Helper(venue.resources, MapLibrary(venue.resources), threading.Event()).help_one()
    assert len(list(parts_folder(venue.resources, build.id).iterdir())) > 10


def test_a_helper_stops_when_the_build_does(venue: Venue, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sharing, "OPTIONS", sharing.SharingOptions(check_s=0.0))
    build, stop = venue.claimed(), threading.Event()
    following = sharing._Following(venue.resources, build, stop)
    following.report("describe", 1, 9)
    with venue.resources.database.write() as connection:
        hand_over(connection, OWNER)
    with pytest.raises(CancelledBuildError):
        following.report("describe", 2, 9)
    # The same worker again, in another attempt.
    again = venue.claim()
    sharing._Following(venue.resources, again, stop).report("describe", 1, 9)
    stop.set()
    with pytest.raises(CancelledBuildError):
        sharing._Following(venue.resources, again, stop).report("describe", 2, 9)


def test_a_helper_leaves_for_a_build_that_it_takes_and_comes_back(
    venue: Venue, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sharing, "OPTIONS", sharing.SharingOptions(check_s=0.0))
    build, only_scans = venue.claimed(), venue.resources.settings.model_copy(update={"worker_kinds": "scan"})
    resources = replace(venue.resources, settings=only_scans)
    parts_folder(resources, build.id).mkdir()
    venue.unpack(build)
    helper = Helper(resources, MapLibrary(resources), threading.Event())
    # Pictures are for other workers.
    venue.submit(poses="estimate")
    following = sharing._Following(resources, build, threading.Event())
    following.report("describe", 1, 9)
    waiting = venue.submit()
    assert helper.help_one()
    made = len(list(parts_folder(resources, build.id).iterdir()))
    withdraw_build(resources, waiting)
    assert helper.help_one()
    assert len(list(parts_folder(resources, build.id).iterdir())) > made + 10
    assert not helper.help_one()


def test_an_idle_worker_sees_at_once_that_a_build_is_shared(venue: Venue) -> None:
    """Not at the next check of the queue: the waits of this test have no end but what they wait for."""
    library, wake, waited = MapLibrary(venue.resources), threading.Event(), threading.Event()
    helper, build = Helper(venue.resources, library, threading.Event()), venue.claimed()

    def wait() -> None:
        helper.wait(wake, float("inf"))
        waited.set()

    for ends in (lambda: parts_folder(venue.resources, build.id).mkdir(), wake.set):
        waited.clear()
        thread = threading.Thread(target=wait, daemon=True)
        thread.start()
        ends()
        assert waited.wait(WAIT_S)
        thread.join()


def test_without_the_setting_nothing_is_shared(venue: Venue) -> None:
    build = venue.claimed()
    parts_folder(venue.resources, build.id).mkdir()
    assert not Helper(venue.alone, MapLibrary(venue.alone), threading.Event()).help_one()
    with shared(venue.alone, build) as own:
        assert own is venue.alone
