"""Entries of an archive by their names: the same twice, and names in the spellings of other systems."""

from __future__ import annotations

import io
import os
import shutil
import struct
import tarfile
import unicodedata
import zipfile
import zlib
from pathlib import Path

import pytest

from app.importers.archives.archive import extract_archive
from app.importers.archives.archive_readers import MIB, ArchiveLimits
from app.importers.registry import open_scan
from tests.importers.scans import write_tum
from tests.importers.test_archive import extracted, refused


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("kind", ["zip", "w", "w:gz"])
def test_the_same_file_twice_is_one_file(tmp_path: Path, kind: str) -> None:
    lines = os.urandom(3_000_000)
    entries = [("rgb.txt", lines), ("depth.txt", b"1"), ("./rgb.txt", lines), ("rgb.txt", lines)]
    archive = tmp_path / "a"
    if kind == "zip":
        with zipfile.ZipFile(archive, "w") as packed:
            for name, data in entries:
                packed.writestr(name, data)
    else:
        with tarfile.open(archive, kind) as tar:  # type: ignore[call-overload]
            for name, data in entries:
                member = tarfile.TarInfo(name)
                member.size = len(data)
                tar.addfile(member, io.BytesIO(data))
    done: list[tuple[int, int]] = []
    root = extract_archive(archive, tmp_path / "out", progress=lambda a, b: done.append((a, b)))
    assert extracted(root) == ["depth.txt", "rgb.txt"]
    assert (root / "rgb.txt").read_bytes() == lines
    assert done[-1] == (9_000_001, 9_000_001)
    # All copies count against the limit.
    shutil.rmtree(tmp_path / "out")
    refused(archive, "unpacks to more than 8 MB", ArchiveLimits(max_total_bytes=8 * MIB))


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_one_name_with_different_contents_of_one_size(tmp_path: Path) -> None:
    first = os.urandom(3_000_000)
    with zipfile.ZipFile(tmp_path / "a", "w") as archive:
        archive.writestr("rgb.txt", first)
        archive.writestr("rgb.txt", first[:-1] + bytes([first[-1] ^ 1]))
    refused(tmp_path / "a", "'rgb.txt' twice, with different contents")


def without_utf8_flag(path: Path, names: dict[bytes, bytes], extra: bytes = b"") -> Path:
    """Write a zip whose names are these bytes, without the flag that says that they are UTF-8."""
    placeholders = {}
    with zipfile.ZipFile(path, "w") as archive:
        for i, (name, data) in enumerate(names.items()):
            placeholder = chr(ord("A") + i) * len(name)
            placeholders[placeholder.encode()] = name
            info = zipfile.ZipInfo(placeholder)
            info.extra = extra
            archive.writestr(info, data)
    data = path.read_bytes()
    for placeholder_bytes, name in placeholders.items():
        data = data.replace(placeholder_bytes, name)
    path.write_bytes(data)
    return path


def test_names_in_utf8_without_the_flag_and_in_decomposed_form(tmp_path: Path) -> None:
    decomposed = unicodedata.normalize("NFD", "küche/größe 1.png")
    archive = without_utf8_flag(tmp_path / "a", {decomposed.encode(): b"1", "深度/0.png".encode(): b"2"})
    root = extract_archive(archive, tmp_path / "out")
    assert extracted(root) == ["küche/größe 1.png", "深度/0.png"]


def test_names_in_another_code_page_meet_the_list(tmp_path: Path) -> None:
    """A packer of Windows: names in its own page, the list in UTF-8."""
    source = write_tum(tmp_path / "source")
    entries = {f"{n}": (source / n).read_bytes() for n in extracted(source)}
    lines = entries["rgb.txt"].decode().replace(" rgb/", " 图像/").encode()
    names = {n.replace("rgb/", "图像/").encode("gb18030"): data for n, data in entries.items()}
    names[b"rgb.txt"] = lines
    assert (
        len(open_scan(extract_archive(without_utf8_flag(tmp_path / "a", names), tmp_path / "out")).frames)
        == 3
    )
    shutil.rmtree(tmp_path / "out")
    names[b"rgb.txt"] = lines.decode().encode("gb18030")
    assert (
        len(open_scan(extract_archive(without_utf8_flag(tmp_path / "a", names), tmp_path / "out")).frames)
        == 3
    )


def test_the_unicode_path_of_info_zip(tmp_path: Path) -> None:
    def field(name: str, raw: bytes) -> bytes:
        content = b"\x01" + struct.pack("<I", zlib.crc32(raw)) + name.encode()
        return struct.pack("<HH", 0x7075, len(content)) + content

    raw = "k\xfcche.png".encode("cp1252")
    archive = without_utf8_flag(tmp_path / "a", {raw: b"1"}, field("küche.png", raw))
    assert extracted(extract_archive(archive, tmp_path / "out")) == ["küche.png"]
    shutil.rmtree(tmp_path / "out")
    # One for another name is old, and a hostile one is checked as any name is.
    archive = without_utf8_flag(tmp_path / "b", {raw: b"1"}, field("other.png", b"other"))
    assert extracted(extract_archive(archive, tmp_path / "out")) == [raw.decode("cp437")]
    shutil.rmtree(tmp_path / "out")
    archive.unlink()
    (tmp_path / "a").unlink()
    refused(without_utf8_flag(tmp_path / "a", {raw: b"1"}, field("../x.png", raw)), "leads out")
