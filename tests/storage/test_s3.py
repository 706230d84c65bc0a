"""Blobs in an S3 server, and the local copies of them."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import pytest

from app.errors import NotFoundError, StorageError
from app.storage.blob_cache import BlobCache
from app.storage.blobs import BlobStore
from tests.s3 import ABSENT, BUCKET, is_installed, s3

needs_s3 = pytest.mark.skipif(not is_installed(), reason=ABSENT)
URL = f"s3://{BUCKET}/blobs"


@pytest.fixture(scope="module")
def variables(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    with s3(tmp_path_factory.mktemp("s3")) as environment:
        yield environment


@pytest.fixture
def blobs(variables: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> BlobStore:
    """A store in the bucket, found by the environment alone, with a cache of 3 MB."""
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    return BlobStore.open(URL, tmp_path, tmp_path / "cache", 3_000_000)


@needs_s3
def test_blobs_are_stored_and_read_whole(blobs: BlobStore, tmp_path: Path) -> None:
    # More than a part of a multipart upload.
    data = os.urandom(12_000_000)
    (tmp_path / "file").write_bytes(data)
    digest = blobs.put_file(tmp_path / "file")
    small = blobs.put(b"small")
    assert digest == hashlib.sha256(data).hexdigest()
    assert (
        blobs.get(digest) == data == b"".join(blobs.stream(digest)) == blobs.local_path(digest).read_bytes()
    )
    assert blobs.size(digest) == len(data)
    assert blobs.digests() == {digest, small} == blobs.older_than(timedelta(0))
    assert not blobs.older_than(timedelta(hours=1))
    blobs.check_writable()
    blobs.delete([digest, small, "0" * 64])
    assert not blobs.contains(digest)
    for read in (blobs.get, lambda name: list(blobs.stream(name))):
        with pytest.raises(NotFoundError, match=digest):
            read(digest)
    assert blobs.forget(digest)
    with pytest.raises(NotFoundError, match=digest):
        blobs.local_path(digest)
    assert blobs.digests() == set()


def test_a_store_that_does_not_answer_is_a_storage_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    for name in ("AWS_ALLOW_HTTP", "AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.setenv(name, "true")
    blobs = BlobStore.open(URL, tmp_path, tmp_path / "cache")
    with pytest.raises(StorageError, match="doesn't answer"):
        blobs.get("0" * 64)


def test_copies_used_longest_ago_go_when_there_are_too_many_bytes(tmp_path: Path) -> None:
    names = [f"{number:064x}" for number in range(4)]
    for age, name in enumerate(names[:3]):
        BlobCache(tmp_path, 1000).add(name, iter([bytes(100)]))
        os.utime(tmp_path / name, (0, time.time() - 1000 + age))
    cache = BlobCache(tmp_path, 250)
    open_copy = (tmp_path / names[1]).open("rb")
    assert cache.find(names[0]) == tmp_path / names[0]
    (tmp_path / f"{names[3]}.partial").write_bytes(b"of a killed process")
    os.utime(tmp_path / f"{names[3]}.partial", (0, 0))
    cache.add(names[3], iter([bytes(50), bytes(50)]))
    # The two that were just used are kept, the others are too much.
    assert {path.name for path in tmp_path.iterdir()} == {names[0], names[3]}
    with open_copy:
        assert open_copy.read() == bytes(100)
    assert cache.find(names[1]) is None


def test_a_copy_that_was_just_used_is_kept_over_the_limit(tmp_path: Path) -> None:
    cache = BlobCache(tmp_path, 0)
    path = cache.add("0" * 64, iter([b"x"]))
    cache.add("1" * 64, iter([b"y"]))
    assert path.read_bytes() == b"x"


def test_a_copy_that_breaks_off_leaves_nothing(tmp_path: Path) -> None:
    def pieces() -> Iterator[bytes]:
        yield b"half"
        raise StorageError("gone")

    with pytest.raises(StorageError):
        BlobCache(tmp_path, 100).add("0" * 64, pieces())
    assert not list(tmp_path.iterdir())
