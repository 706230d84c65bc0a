"""Workers that take builds of some kinds only, on both databases; what kind an archive is of."""

from __future__ import annotations

import io
import tarfile
from pathlib import Path

import pytest

from app.engine.mapping.options import parse_build_options
from app.errors import InvalidInputError
from app.services.submit_build import kind_of
from app.settings import read_settings
from tests.jobs.test_leases import VENUE, Workers, site
from tests.scenes import zipped
from tests.server import wait_for

PHOTOS = {f"photo-{number}.jpg": b"not a picture" for number in range(3)}


def queued(workers: Workers) -> dict[str, str]:
    """Return the metric of the queue: its length by kind."""
    lines = workers.server.client.get("/metrics").text.splitlines()
    found = [line.split('"') for line in lines if line.startswith("roomfix_builds_queued{")]
    return {kind: number.strip(" }") for _, kind, number in found}


def test_a_worker_of_scans_leaves_pictures_to_the_other(workers: Workers) -> None:
    pictures = str(workers.server.submit(zipped(PHOTOS), VENUE, {}).json()["build"])
    scans = [workers.submit(), workers.submit()]
    assert workers.server.status(pictures)["kind"] == "pictures"
    assert queued(workers) == {"scan": "2.0", "recording": "0.0", "pictures": "1.0"}
    workers.start(ROOMFIX_WORKER_KINDS="scan, recording")
    # They came later, and are done while the pictures still wait.
    assert [workers.server.wait(build)["state"] for build in scans] == ["succeeded", "succeeded"]
    assert workers.server.status(pictures)["state"] == "queued"
    workers.hold("unpack")
    workers.start(ROOMFIX_WORKER_KINDS="pictures")
    wait_for(lambda: workers.server.status(pictures)["state"] == "running")
    later = workers.submit()
    workers.release()
    assert workers.server.wait(later)["state"] == "succeeded"
    # What it holds is no picture; every kind ends with a reason.
    assert workers.server.wait(pictures)["error"]


def test_every_kind_is_begun_anew_after_a_death_and_can_be_cancelled(tmp_path: Path, scan: bytes) -> None:
    with site(tmp_path, scan, None) as workers:
        for options in ({"format": "tum"}, {"format": "recording"}, {"format": "images"}):
            workers.hold("unpack")
            dying = workers.start()
            build = str(workers.server.submit(zipped(PHOTOS), VENUE, options).json()["build"])
            workers.wait_until_held()
            dying.kill()
            dying.wait()
            (tmp_path / "held").unlink()
            living = workers.start()
            workers.wait_until_held()
            again = workers.server.status(build)
            assert (again["state"], again["attempts"]) == ("running", 2), options
            assert workers.server.client.delete(f"/database/builds/{build}").status_code == 202
            workers.release()
            assert workers.server.wait(build)["state"] == "cancelled", options
            living.kill()
            living.wait()


def test_a_kind_follows_from_options_and_names(tmp_path: Path, scan: bytes) -> None:
    def kind(data: bytes, **options: object) -> str:
        path = tmp_path / "sent"
        path.write_bytes(data)
        return kind_of(parse_build_options(options), path)

    photos, video = zipped(PHOTOS), zipped({"walk.mp4": b"\0"})
    assert [kind(data) for data in (scan, photos, video)] == ["scan", "pictures", "pictures"]
    # A video as it is, without an archive around it.
    assert kind(b"\0\0\0\x18ftypmp42" + bytes(100)) == "pictures"
    assert kind(scan, poses="estimate") == "pictures"
    assert kind(scan, format="images") == "pictures"
    assert kind(scan, format="recording") == "recording"
    assert kind(photos, format="tum") == "scan"
    # Not looked into, or not to be read: the build says what is wrong.
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w:gz") as archive:
        archive.addfile(tarfile.TarInfo("walk.mp4"))
    damaged, outside = photos.replace(b"PK\1\2", b"PK\0\0"), zipped({"../walk.mp4": b"\0"})
    unread = packed.getvalue(), damaged, outside, b"no archive"
    assert [kind(data) for data in unread] == ["scan"] * 4


def test_a_kind_that_is_none_is_refused_at_the_start() -> None:
    assert read_settings({"worker_kinds": "pictures,scan"}).kinds_of_builds == ("scan", "pictures")
    assert read_settings({}).kinds_of_builds == ("scan", "recording", "pictures")
    with pytest.raises(
        InvalidInputError, match="'videos' is no kind of build; the kinds are scan, recording"
    ):
        read_settings({"worker_kinds": "scan,videos"})
