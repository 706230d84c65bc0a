"""Archives packed by LZMA: whole ones are read, and a dictionary too large for the server is refused unread."""

from __future__ import annotations

import io
import lzma
import tarfile
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest

from app.errors import InvalidScanError
from app.importers.archives.archive import extract_archive

CONTENT = np.random.default_rng(0).integers(0, 20, 300_000, dtype=np.uint8).tobytes()
# 1.5 GB in the encoding of xz.
HUGE_XZ, HUGE_BYTES = 37, 3 << 29


def tar_of(content: bytes) -> bytes:
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w") as tar:
        info = tarfile.TarInfo("rgb.txt")
        info.size = len(content)
        tar.addfile(info, io.BytesIO(content))
    return packed.getvalue()


def with_huge_dictionary(packed: bytes) -> bytes:
    """Return an xz file whose first block states a dictionary of 1.5 GB."""
    size = 4 * (packed[12] + 1)
    header = bytearray(packed[12 : 12 + size - 4])
    assert header[2:4] == b"\x21\x01"
    header[4] = HUGE_XZ
    return packed[:12] + bytes(header) + zlib.crc32(header).to_bytes(4, "little") + packed[12 + size :]


def unpacked(data: bytes, folder: Path) -> bytes:
    (folder / "archive").write_bytes(data)
    return (extract_archive(folder / "archive", folder / "scan") / "rgb.txt").read_bytes()


@pytest.mark.parametrize("padding", [b"", b"\0" * 8], ids=["", "padded"])
def test_xz_streams_one_after_the_other_are_one_file(tmp_path: Path, padding: bytes) -> None:
    tar = tar_of(CONTENT)
    parts = [lzma.compress(part, preset=9) for part in (tar[:1000], tar[1000:-5], tar[-5:])]
    assert unpacked(padding.join(parts) + padding, tmp_path) == CONTENT


def test_a_huge_xz_dictionary_is_refused(tmp_path: Path) -> None:
    packed = with_huge_dictionary(lzma.compress(tar_of(CONTENT)))
    with pytest.raises(InvalidScanError, match="dictionary"):
        unpacked(packed, tmp_path)


@pytest.mark.parametrize("cut", [40, 1000, -1])
def test_an_xz_file_cut_short_is_damaged(tmp_path: Path, cut: int) -> None:
    with pytest.raises(InvalidScanError, match="damaged"):
        unpacked(lzma.compress(tar_of(CONTENT))[:cut], tmp_path)


@pytest.mark.parametrize("is_huge", [False, True], ids=["usual", "huge"])
def test_the_dictionary_of_a_zip_entry_is_bounded(tmp_path: Path, is_huge: bool) -> None:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("rgb.txt", CONTENT)
    data = bytearray(packed.getvalue())
    # After a local header of 30 bytes and the name: version, size of the properties, one byte, the dictionary.
    first = 30 + len("rgb.txt") + 5
    if is_huge:
        data[first : first + 4] = HUGE_BYTES.to_bytes(4, "little")
        with pytest.raises(InvalidScanError, match="dictionary"):
            unpacked(bytes(data), tmp_path)
    else:
        assert unpacked(bytes(data), tmp_path) == CONTENT
