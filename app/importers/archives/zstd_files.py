"""Recordings packed by zstd, as rosbag2 packs a bag's files: unpacked with bounds on memory and size.

The library is that of Python 3.14, which `rosbags` brings for the versions before.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import BinaryIO

from app.errors import InvalidScanError
from app.importers.archives.archive_readers import MIB, ArchiveLimits, Entry, EntryKind
from app.limits import limit

MAGIC = b"\x28\xb5\x2f\xfd"
# Of bags: rosbag2 writes the first, people who pack by hand the second.
PACKED_SUFFIXES = tuple(f"{bag}{packed}" for bag in (".db3", ".mcap") for packed in (".zstd", ".zst"))
_LIBRARY = "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"


@dataclass(frozen=True, slots=True, kw_only=True)
class ZstdOptions:
    """How much memory unpacking may take."""

    max_window_log: int = limit(
        26,
        "Logarithm to base 2 of the bytes that unpacking a zstd file may keep in memory.",
        chosen="By hand: 64 MB; rosbag2 packs with less than 1 MB, and zstd -19 with 8 MB.",
    )


OPTIONS = ZstdOptions()


def first_bytes(path: Path, count: int) -> bytes:
    """Return the first bytes of what a zstd file holds, nothing for one that can't be read."""
    try:
        with path.open("rb") as file, _unpacked(file, path.name) as stream:
            return stream.read(count)
    except InvalidScanError:
        return b""


def unpack_files(paths: Sequence[Path], folder: Path, limits: ArchiveLimits | None = None) -> list[Path]:
    """Unpack zstd files into a folder, under their names without the last suffix, and return the unpacked ones.

    Raises `InvalidScanError` for damage, for more bytes or compression than `limits`, and without the library.
    """
    limits = limits or ArchiveLimits()
    packed_bytes, total = sum(path.stat().st_size for path in paths), 0
    targets = [folder / path.stem for path in paths]
    for path, target in zip(paths, targets, strict=True):
        done, size = 0, path.stat().st_size
        with path.open("rb") as file, target.open("wb") as out, _unpacked(file, path.name) as stream:
            while chunk := stream.read(MIB):
                done, total = done + len(chunk), total + len(chunk)
                limits.check_entry(Entry(path.name, done, size, EntryKind.FILE), is_recording=True)
                limits.check_total(total, packed_bytes)
                out.write(chunk)
    return targets


@contextmanager
def _unpacked(file: BinaryIO, name: str) -> Iterator[BinaryIO]:
    """Yield the unpacked bytes of a file; damage that is met within the block becomes an `InvalidScanError`."""
    zstd = _library()
    try:
        with zstd.open(
            file, "rb", options={zstd.DecompressionParameter.window_log_max: OPTIONS.max_window_log}
        ) as stream:
            yield stream
    except zstd.ZstdError as error:
        if "too much memory" in str(error):
            raise InvalidScanError(
                f"{name} needs more than {2**OPTIONS.max_window_log // MIB} MB of memory to be unpacked; pack it with "
                "zstd -19 or less."
            ) from None
        raise InvalidScanError(f"{name} is damaged: zstd can't unpack it.") from None
    except EOFError:
        raise InvalidScanError(f"{name} is cut short: copy it again.") from None


def _library() -> ModuleType:
    try:
        return import_module(_LIBRARY)
    except ImportError:
        raise InvalidScanError("Bags packed by zstd need the extra: pip install 'roomfix[scans]'.") from None
