"""Blobs: content-addressed, whole or not there, removed only when nothing needs them."""

from __future__ import annotations

import hashlib
import io
import os
import threading
import time
from datetime import timedelta
from pathlib import Path

import pytest

from app.errors import NotFoundError
from app.services.resources import Resources
from app.services.submit_build import submit_build, withdraw_build
from app.settings import Settings
from app.storage.blobs import BlobStore
from app.storage.builds import get_build
from app.storage.sweep import discard_blobs, sweep_blobs, sweep_scratch
from app.storage.venues import create_venue

HOUR = timedelta(hours=1)
CAMERA = {"camera": "262,262,159,119"}


@pytest.fixture
def blobs(tmp_path: Path) -> BlobStore:
    """A store in a folder."""
    return BlobStore.open(None, tmp_path, tmp_path / "cache")


@pytest.fixture
def resources(tmp_path: Path) -> Resources:
    """Database, blobs and scratch folder, with the venue `v`."""
    opened = Resources.open(Settings(_env_file=None, data_dir=tmp_path, open=True))
    with opened.database.write() as connection:
        create_venue(connection, "v", "V")
    return opened


def test_a_blob_is_found_by_its_sha256(blobs: BlobStore, tmp_path: Path) -> None:
    data = os.urandom(3_000_000)
    digest = blobs.put(data)
    assert digest == hashlib.sha256(data).hexdigest()
    assert blobs.get(digest) == data
    assert blobs.local_path(digest).read_bytes() == data
    (tmp_path / "file").write_bytes(data)
    assert blobs.put_file(tmp_path / "file") == digest
    assert blobs.digests() == {digest}
    assert blobs.contains(digest)
    assert blobs.put(b"") == hashlib.sha256(b"").hexdigest()


def test_a_blob_that_is_not_there(blobs: BlobStore) -> None:
    missing = "0" * 64
    assert not blobs.contains(missing)
    for read in (blobs.get, blobs.local_path):
        with pytest.raises(NotFoundError, match=missing):
            read(missing)
    blobs.delete([missing])


def test_a_url_store_works_through_its_cache(tmp_path: Path) -> None:
    (tmp_path / "remote").mkdir()
    store = BlobStore.open((tmp_path / "remote").as_uri(), tmp_path, tmp_path / "cache")
    digest = store.put(b"remote bytes")
    path = store.local_path(digest)
    assert path.is_relative_to(tmp_path / "cache")
    assert path.read_bytes() == b"remote bytes"
    assert store.local_path(digest) == path
    with pytest.raises(NotFoundError):
        store.local_path("0" * 64)
    assert [item.name for item in (tmp_path / "cache").iterdir()] == [digest]
    store.delete([digest])
    assert store.digests() == set()


def test_only_old_blobs_count_as_old_and_storing_again_renews(blobs: BlobStore) -> None:
    old, new = blobs.put(b"old"), blobs.put(b"new")
    past = time.time() - 7200
    for data in (b"old", b"new"):
        os.utime(blobs.local_path(hashlib.sha256(data).hexdigest()), (past, past))
    assert blobs.older_than(HOUR) == {old, new}
    blobs.put(b"new")
    assert blobs.older_than(HOUR) == {old}


def test_writes_that_were_cut_off_are_swept(blobs: BlobStore) -> None:
    kept = blobs.put(b"whole")
    staged = blobs.local_path(kept).with_name(kept + "#1")
    staged.write_bytes(b"ha")
    assert blobs.sweep_staging(HOUR) == 0
    assert blobs.sweep_staging(timedelta(0)) == 1
    assert not staged.exists()
    assert blobs.contains(kept)


def test_the_sweep_keeps_what_rows_refer_to(resources: Resources) -> None:
    build = submit_build(resources, "v", CAMERA, io.BytesIO(b"archive"))
    orphan = resources.blobs.put(b"orphan")
    assert sweep_blobs(resources.database, resources.blobs, HOUR) == 0
    assert sweep_blobs(resources.database, resources.blobs, timedelta(0)) == 1
    assert not resources.blobs.contains(orphan)
    with resources.database.read() as connection:
        archive = get_build(connection, build).archive_blob
    assert resources.blobs.digests() == {archive}
    assert discard_blobs(resources.database, resources.blobs, [archive]) == 0
    withdraw_build(resources, build)
    assert resources.blobs.digests() == set()


def test_old_scratch_files_are_swept(tmp_path: Path) -> None:
    (tmp_path / "folder" / "inside").mkdir(parents=True)
    (tmp_path / "upload-1").write_bytes(b"x")
    assert sweep_scratch(tmp_path, HOUR) == 0
    assert sweep_scratch(tmp_path, timedelta(0)) == 2
    assert not list(tmp_path.iterdir())


def test_an_upload_keeps_an_archive_that_another_build_discards_under_it(
    resources: Resources, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The moment between storing the archive and committing its row: the last build of the same archive ends."""
    first = submit_build(resources, "v", CAMERA, io.BytesIO(b"same scan"))
    put_file = BlobStore.put_file
    interrupted: list[str] = []

    def put_and_be_overtaken(self: BlobStore, path: Path) -> str:
        digest = put_file(self, path)
        if not interrupted:
            interrupted.append(digest)
            withdraw_build(resources, first)
            assert not self.contains(digest)
        return digest

    monkeypatch.setattr(BlobStore, "put_file", put_and_be_overtaken)
    submit_build(resources, "v", CAMERA, io.BytesIO(b"same scan"))
    assert interrupted
    assert resources.blobs.get(interrupted[0]) == b"same scan"


def test_uploads_and_cancellations_of_one_archive_at_once_lose_nothing(resources: Resources) -> None:
    lost: list[str] = []

    def submit_and_withdraw() -> None:
        for _ in range(15):
            build = submit_build(resources, "v", CAMERA, io.BytesIO(b"the one archive"))
            with resources.database.read() as connection:
                archive = get_build(connection, build).archive_blob
            if not resources.blobs.contains(archive):
                lost.append(build)
            withdraw_build(resources, build)

    threads = [threading.Thread(target=submit_and_withdraw) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not lost
    assert resources.blobs.digests() == set()
