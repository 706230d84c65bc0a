"""Archives: the good ones, and those that want to write elsewhere, fill the disk or break the reader."""

from __future__ import annotations

import gzip
import io
import lzma
import os
import shutil
import stat
import struct
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from app.errors import CancelledBuildError, InvalidScanError
from app.importers.archives.archive import extract_archive
from app.importers.archives.archive_readers import ArchiveLimits
from app.importers.registry import open_scan
from tests.importers.scans import write_tum

MIB = 1024 * 1024
SMALL = ArchiveLimits(max_total_bytes=4 * MIB, max_entries=50, max_entry_bytes=MIB, ratio_free_bytes=MIB // 2)
TAR_MODES = ("w", "w:gz", "w:bz2", "w:xz")


def make_zip(path: Path, entries: dict[str, bytes], compression: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, data in entries.items():
            archive.writestr(zipfile.ZipInfo(name), data, compression)
    return path


def make_tar(path: Path, entries: dict[str, bytes], mode: str = "w") -> Path:
    with tarfile.open(path, mode) as archive:  # type: ignore[call-overload]
        for name, data in entries.items():
            member = tarfile.TarInfo(name)
            member.size = len(data)
            archive.addfile(member, io.BytesIO(data))
    return path


def make_tar_member(path: Path, **fields: object) -> Path:
    """Write a tar of one good file and one entry without contents that has the given fields."""
    with tarfile.open(path, "w") as archive:
        good = tarfile.TarInfo("rgb.txt")
        good.size = 1
        archive.addfile(good, io.BytesIO(b"x"))
        member = tarfile.TarInfo("depth.txt")
        for name, value in fields.items():
            setattr(member, name, value)
        archive.addfile(member)
    return path


def extracted(folder: Path) -> list[str]:
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())


def refused(archive: Path, message: str, limits: ArchiveLimits | None = None) -> None:
    """Check that the archive is refused and that nothing is left of it."""
    before = set(archive.parent.rglob("*"))
    with pytest.raises(InvalidScanError, match=message):
        extract_archive(archive, archive.parent / "out", limits)
    assert set(archive.parent.rglob("*")) == before


@pytest.mark.parametrize("kind", ["zip", *TAR_MODES])
def test_a_scan_survives_the_journey_whatever_the_archive_is_called(tmp_path: Path, kind: str) -> None:
    source = write_tum(tmp_path / "source/my scan")
    archive = tmp_path / "upload.bin"
    if kind == "zip":
        entries = {f"my scan/{n}": (source / n).read_bytes() for n in extracted(source)}
        make_zip(archive, entries)
    else:
        with tarfile.open(archive, kind) as tar:  # type: ignore[call-overload]
            tar.add(source.parent, ".")
    steps: list[tuple[int, int]] = []
    root = extract_archive(
        archive, tmp_path / "out", progress=lambda done, total: steps.append((done, total))
    )
    assert root == tmp_path / "out/my scan"
    assert extracted(root) == extracted(source)
    assert all((root / n).read_bytes() == (source / n).read_bytes() for n in extracted(source))
    assert len(open_scan(root).frames) == 3
    assert steps[-1][0] == steps[-1][1] == sum((source / n).stat().st_size for n in extracted(source))


def test_a_scan_at_the_top_stays_there(tmp_path: Path) -> None:
    archive = make_zip(tmp_path / "a", {"rgb.txt": b"1", "rgb\\0.png": b"2", "./depth/0.png": b"3"})
    assert extract_archive(archive, tmp_path / "out") == tmp_path / "out"
    assert extracted(tmp_path / "out") == ["depth/0.png", "rgb.txt", "rgb/0.png"]


@pytest.mark.parametrize("make", [make_zip, make_tar])
def test_only_what_the_importers_read_is_written(tmp_path: Path, make: Callable[..., Path]) -> None:
    names = [
        "scan/rgb.txt",
        "scan/.DS_Store",
        "__MACOSX/scan/._rgb.txt",
        "scan/._rgb.txt",
        "scan/Thumbs.db",
        "scan/.git/config.txt",
        "scan/run.sh",
        "scan/big.bag",
        "scan/big.svo2",
    ]
    # A recording may be larger than other files, which hold one frame.
    big = {"scan/big.bag": np.random.default_rng(1).bytes(2 * MIB), "scan/big.svo2": b"x" * MIB}
    archive = make(tmp_path / "a", {name: big.get(name, b"x" * 9) for name in names})
    root = extract_archive(archive, tmp_path / "out", SMALL if make is make_zip else None)
    assert root == tmp_path / "out/scan"
    assert extracted(root) == ["big.bag", "big.svo2", "rgb.txt"]
    assert (root / "big.bag").stat().st_size == 2 * MIB
    # A recording that no importer reads is there by name alone, so that its format can be named.
    assert (root / "big.svo2").stat().st_size == 0


HOSTILE_NAMES = [
    ("../rgb.txt", "leads out"),
    ("scan/../../rgb.txt", "leads out"),
    ("scan\\..\\..\\rgb.txt", "leads out"),
    ("/tmp/rgb.txt", "leads out"),
    ("\\\\server\\rgb.txt", "leads out"),
    ("C:\\rgb.txt", "leads out"),
    ("c:rgb.txt", "leads out"),
    ("rgb\n.txt", "characters"),
    ("rgb\x1b[2J.txt", "characters"),
    ("a" * 300 + ".txt", "too long"),
    ("/".join(["a"] * 40) + "/rgb.txt", "too long or too deep"),
]


@pytest.mark.parametrize("make", [make_zip, make_tar])
@pytest.mark.parametrize(("name", "message"), HOSTILE_NAMES, ids=range(len(HOSTILE_NAMES)))
def test_hostile_names(tmp_path: Path, make: Callable[..., Path], name: str, message: str) -> None:
    refused(make(tmp_path / "a", {"rgb.txt": b"good", name: b"bad"}), message)


def test_a_name_with_a_nul_does_not_hide_its_end(tmp_path: Path) -> None:
    archive = make_zip(tmp_path / "a", {"rgb.txt_exe": b"bad"})
    archive.write_bytes(archive.read_bytes().replace(b"rgb.txt_exe", b"rgb.txt\x00exe"))
    refused(archive, "characters")


def test_bytes_that_are_no_text_are_no_name(tmp_path: Path) -> None:
    with tarfile.open(tmp_path / "a", "w", format=tarfile.USTAR_FORMAT) as archive:
        archive.addfile(tarfile.TarInfo("rgb\udcff.txt"))
    refused(tmp_path / "a", "characters")


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"type": tarfile.SYMTYPE, "linkname": "/etc/passwd"}, "is a link"),
        ({"type": tarfile.SYMTYPE, "linkname": "rgb.txt"}, "is a link"),
        ({"type": tarfile.LNKTYPE, "linkname": "rgb.txt"}, "is a link"),
        ({"type": tarfile.CHRTYPE}, "neither a file nor a folder"),
        ({"type": tarfile.BLKTYPE}, "neither a file nor a folder"),
        ({"type": tarfile.FIFOTYPE}, "neither a file nor a folder"),
        ({"type": tarfile.DIRTYPE, "name": "../escape"}, "leads out"),
        ({"name": "rgb.txt"}, "twice"),
        ({"name": "./rgb.txt"}, "twice"),
        ({"name": "rgb.txt/0.png"}, "both as a file and as a folder"),
    ],
)
def test_hostile_tar_entries(tmp_path: Path, fields: dict[str, object], message: str) -> None:
    refused(make_tar_member(tmp_path / "a", **fields), message)


@pytest.mark.parametrize(
    ("mode", "message"), [(stat.S_IFLNK, "is a link"), (stat.S_IFCHR, "neither"), (stat.S_IFIFO, "neither")]
)
def test_hostile_zip_entries(tmp_path: Path, mode: int, message: str) -> None:
    info = zipfile.ZipInfo("depth.txt")
    info.external_attr = (mode | 0o777) << 16
    with zipfile.ZipFile(tmp_path / "a", "w") as archive:
        archive.writestr("rgb.txt", "x")
        archive.writestr(info, "/etc/passwd")
    refused(tmp_path / "a", message)


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_duplicates_in_a_zip(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a", "w") as archive:
        archive.writestr("rgb.txt", "1")
        archive.writestr("./rgb.txt", "2")
    refused(tmp_path / "a", "twice")


def test_an_encrypted_zip(tmp_path: Path) -> None:
    archive = make_zip(tmp_path / "a", {"rgb.txt": b"x"}, zipfile.ZIP_STORED)
    data = bytearray(archive.read_bytes())
    data[6] |= 1
    data[data.index(b"PK\x01\x02") + 8] |= 1
    archive.write_bytes(bytes(data))
    refused(archive, "encrypted; send it without a password")


def test_a_zip_of_unknown_compression(tmp_path: Path) -> None:
    archive = make_zip(tmp_path / "a", {"rgb.txt": b"x"}, zipfile.ZIP_STORED)
    data = bytearray(archive.read_bytes())
    data[8] = data[data.index(b"PK\x01\x02") + 10] = 97
    archive.write_bytes(bytes(data))
    refused(archive, "compression that is not known")


@pytest.mark.parametrize(
    "data", [b"", b"hello", b"\x89PNG\r\n\x1a\n" + bytes(2000), bytes(20_480), b"\x1f\x8bno"]
)
def test_what_is_no_archive(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "scan.zip").write_bytes(data)
    refused(tmp_path / "scan.zip", "not an archive|damaged|a single picture")


def test_archives_without_a_scan(tmp_path: Path) -> None:
    refused(make_zip(tmp_path / "a", {}), "holds no images")
    refused(make_zip(tmp_path / "a", {"notes.doc": b"x"}), "holds no images")


@pytest.mark.parametrize("kind", ["zip", *TAR_MODES])
@pytest.mark.parametrize("share", [0.3, 0.6, 0.97])
def test_archives_that_were_cut_off(tmp_path: Path, kind: str, share: float) -> None:
    entries = {f"rgb/{i}.png": os.urandom(40_000) for i in range(5)}
    archive = make_zip(tmp_path / "a", entries) if kind == "zip" else make_tar(tmp_path / "a", entries, kind)
    # A plain tar ends in 10 kB of padding that nobody misses.
    data = archive.read_bytes().rstrip(b"\x00") if kind == "w" else archive.read_bytes()
    archive.write_bytes(data[: int(len(data) * share)])
    refused(archive, "damaged or was cut off")


@pytest.mark.parametrize("share", [0.41, 0.6])
def test_a_tar_does_not_end_early_at_a_header_that_cannot_be_read(tmp_path: Path, share: float) -> None:
    archive = make_tar(tmp_path / "a", {f"{i}.txt": b"x" for i in range(10)})
    data = bytearray(archive.read_bytes())[: 20 * 512]
    data[int(10 * share) * 1024 + 150] ^= 0xFF
    archive.write_bytes(bytes(data))
    refused(archive, "damaged or was cut off")
    archive.write_bytes(bytes(data[: 4 * 1024 + 100]))
    refused(archive, "damaged or was cut off")


@pytest.mark.parametrize("kind", ["zip", "w", "w:gz", "w:bz2", "w:xz"])
def test_random_damage_is_reported_as_such(tmp_path: Path, kind: str) -> None:
    random = np.random.default_rng(3)
    entries = {f"scan/rgb/{i}.txt": bytes(random.integers(97, 100, 400, np.uint8)) for i in range(4)}
    archive = make_zip(tmp_path / "a", entries) if kind == "zip" else make_tar(tmp_path / "a", entries, kind)
    whole = np.frombuffer(archive.read_bytes(), np.uint8)
    outcomes = set()
    for trial in range(100):
        data = whole.copy()
        data[random.integers(0, len(data), trial % 8 + 1)] = random.choice([0, 1, 0x7F, 0x80, 0xFF])
        archive.write_bytes(data.tobytes())
        try:
            extract_archive(archive, tmp_path / "out", SMALL)
            outcomes.add("unpacked")
        except InvalidScanError:
            assert not (tmp_path / "out").exists()
            outcomes.add("refused")
        shutil.rmtree(tmp_path / "out", ignore_errors=True)
    assert "refused" in outcomes


@pytest.mark.parametrize("kind", ["zip", "w:gz"])
def test_flipped_bytes_are_found_while_writing(tmp_path: Path, kind: str) -> None:
    entries = {f"rgb/{i}.png": os.urandom(40_000) for i in range(5)}
    archive = make_zip(tmp_path / "a", entries) if kind == "zip" else make_tar(tmp_path / "a", entries, kind)
    data = bytearray(archive.read_bytes())
    data[len(data) // 2] ^= 0xFF
    archive.write_bytes(bytes(data))
    refused(archive, "damaged")


def test_600_megabytes_of_zeros(tmp_path: Path) -> None:
    with (
        zipfile.ZipFile(tmp_path / "a", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("rgb/a.png", "w", force_zip64=True) as entry,
    ):
        for _ in range(600):
            entry.write(bytes(MIB))
    refused(tmp_path / "a", "600 MB unpacked; the limit for one file is 256 MB")


def test_zeros_below_the_limit_for_one_file(tmp_path: Path) -> None:
    refused(
        make_zip(tmp_path / "a", {"rgb/a.png": bytes(900_000)}), "'rgb/a.png' unpacks to more than 200", SMALL
    )
    many = {f"rgb/{i}.png": bytes(400_000) for i in range(5)}
    refused(make_zip(tmp_path / "a", many), "archive unpacks to more than 200 times", SMALL)
    refused(make_tar(tmp_path / "a", many, "w:gz"), "archive unpacks to more than 200 times", SMALL)


def test_limits_on_entries_and_bytes(tmp_path: Path) -> None:
    for make in (make_zip, make_tar):
        refused(make(tmp_path / "a", {f"{i}.txt": b"x" for i in range(51)}), "more than 50 entries", SMALL)
        refused(make(tmp_path / "a", {"a.txt": os.urandom(MIB + 1)}), "the limit for one file is 1 MB", SMALL)
        five = {f"{i}.txt": os.urandom(900_000) for i in range(5)}
        refused(make(tmp_path / "a", five), "unpacks to more than 4 MB", SMALL)


def test_a_zip_that_lies_about_its_sizes(tmp_path: Path) -> None:
    archive = make_zip(tmp_path / "a", {"rgb/a.png": bytes(900_000)})
    data = bytearray(archive.read_bytes())
    for at in (22, data.index(b"PK\x01\x02") + 24):
        data[at : at + 4] = struct.pack("<I", 1000)
    archive.write_bytes(bytes(data))
    refused(archive, "damaged", SMALL)


def test_a_zip_whose_entries_share_their_data(tmp_path: Path) -> None:
    archive = make_zip(
        tmp_path / "a", {f"{i}.png": os.urandom(300_000) for i in range(8)}, zipfile.ZIP_STORED
    )
    data = bytearray(archive.read_bytes())
    at = data.index(b"PK\x01\x02")
    while data[at : at + 4] == b"PK\x01\x02":
        data[at + 42 : at + 46] = bytes(4)
        at += 46 + sum(struct.unpack("<HHH", data[at + 28 : at + 34]))
    archive.write_bytes(bytes(data))
    refused(archive, "damaged", SMALL)


def test_a_table_of_contents_that_would_fill_the_memory(tmp_path: Path) -> None:
    limits = ArchiveLimits(max_entries=10)
    archive = make_zip(tmp_path / "a", {f"{i:06d}.txt": b"" for i in range(20_000)})
    refused(archive, "longer table of contents", limits)


def test_tar_headers_that_would_fill_the_memory(tmp_path: Path) -> None:
    with tarfile.open(tmp_path / "a", "w", format=tarfile.PAX_FORMAT) as archive:
        member = tarfile.TarInfo("rgb.txt")
        member.pax_headers = {"comment": "x" * (3 * MIB)}
        archive.addfile(member)
    refused(tmp_path / "a", "longer headers")
    fields = {f"field{i}": "x" for i in range(100)}
    with tarfile.open(tmp_path / "a", "w", format=tarfile.PAX_FORMAT, pax_headers=fields) as archive:
        archive.addfile(tarfile.TarInfo("rgb.txt"))
    refused(tmp_path / "a", "more header fields")


@pytest.mark.parametrize("size", [-1, -512, -1024, -1536, -(2**40)])
def test_a_tar_entry_of_negative_size_does_not_loop(tmp_path: Path, size: int) -> None:
    data = bytearray(make_tar(tmp_path / "a", {"rgb.txt": b"x", "depth.txt": b"y"}).read_bytes())
    header = memoryview(data)[1024:1536]
    header[124:136] = size.to_bytes(12, "big", signed=True)
    header[148:156] = b" " * 8
    header[148:156] = f"{sum(header):06o}\0 ".encode()
    (tmp_path / "a").write_bytes(data)
    refused(tmp_path / "a", "damaged")


def test_a_stream_of_zeros_that_claims_to_be_a_tar(tmp_path: Path) -> None:
    head = tarfile.TarInfo("rgb/a.dat")
    head.size = 60 * MIB
    with lzma.open(tmp_path / "a", "w", preset=0) as file:
        file.write(head.tobuf() + bytes(60 * MIB))
    refused(tmp_path / "a", "more than 200 times its size")


def test_what_follows_the_end_of_a_tar_counts(tmp_path: Path) -> None:
    tar = make_tar(tmp_path / "b", {"rgb.txt": b"x"}).read_bytes()
    (tmp_path / "a").write_bytes(gzip.compress(tar + bytes(60 * MIB), 1))
    refused(tmp_path / "a", "more than 200 times its size")


def test_cancelling_leaves_nothing(tmp_path: Path) -> None:
    archive = make_zip(tmp_path / "a", {f"{i}.txt": b"x" * 1000 for i in range(5)})

    def cancel(done: int, _total: int) -> None:
        if done > 2000:
            raise CancelledBuildError("The build was cancelled.")

    with pytest.raises(CancelledBuildError):
        extract_archive(archive, tmp_path / "out", progress=cancel)
    assert not (tmp_path / "out").exists()


def test_the_callers_own_errors_are_not_called_damage(tmp_path: Path) -> None:
    def fail(_done: int, _total: int) -> None:
        raise ValueError("mine")

    for make in (make_zip, make_tar):
        with pytest.raises(ValueError, match="mine"):
            extract_archive(make(tmp_path / "a", {"a.txt": b"x"}), tmp_path / "out", progress=fail)


def test_a_destination_in_use_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/mine.txt").write_text("mine")
    with pytest.raises(FileExistsError):
        extract_archive(make_zip(tmp_path / "a", {"rgb.txt": b"x"}), tmp_path / "out")
    assert (tmp_path / "out/mine.txt").read_text() == "mine"
