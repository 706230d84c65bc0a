"""Unpacking an uploaded scan: everything is checked before anything is written, and again while writing."""

from __future__ import annotations

import os
import re
import shutil
import unicodedata
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePath, PurePosixPath
from typing import BinaryIO

from app.errors import InvalidScanError
from app.importers.archives.archive_readers import (
    ArchiveLimits,
    Entry,
    EntryKind,
    damage_reported,
    open_reader,
)
from app.importers.archives.lone_recording import lone_recording, suffix_of_recording
from app.importers.archives.zstd_files import PACKED_SUFFIXES
from app.importers.unread.single_files import UNREAD_SUFFIXES

# What the importers read, and image files that they refuse by name. All else in an archive, from thumbnails'
# data bases to meshes, stays in it.
NEEDED_SUFFIXES = frozenset(
    {
        ".png", ".jpg", ".jpeg", ".jpe", ".webp", ".heic", ".heif", ".avif", ".tif", ".tiff", ".bmp", ".gif",
        ".pgm", ".ppm", ".pnm", ".exr", ".npy", ".npz", ".pfm", ".hdr", ".jp2", ".raw", ".bin", ".depth",
        ".txt", ".csv", ".json", ".log", ".traj", ".tum", ".freiburg", ".pincam", ".conf", ".yaml", ".yml",
    }
)  # fmt: skip
# A file of Record3D that has no suffix.
NEEDED_NAMES = frozenset({"metadata"})
# Recordings that hold all frames in one file.
RECORDING_SUFFIXES = frozenset(
    {".mp4", ".mov", ".m4v", ".mkv", ".avi", ".webm", ".bag", ".mcap", ".db", ".db3", ".sens", ".r3d"}
)
# What file managers add unasked.
_OF_DESKTOPS = frozenset({"__macosx", "thumbs.db", "desktop.ini"})

# What file systems take: 255 bytes a name on all of them, and folders as deep as no scan has them.
MAX_PATH_BYTES = 512
MAX_NAME_BYTES = 200
MAX_FOLDERS = 16
_CHUNK_BYTES = 1024 * 1024

Progress = Callable[[int, int], None]


def extract_archive(
    archive: Path,
    destination: Path,
    limits: ArchiveLimits | None = None,
    progress: Progress | None = None,
) -> Path:
    """Unpack a scan's archive and return the scan's folder: the destination, or the one that holds it all.

    Zip and tar (plain, gzip, xz or bzip2) are told apart by their contents; a recording that was sent by itself becomes
    the only file. `destination` must not exist or be empty. `progress(done_bytes, total_bytes)` is called while
    writing; it cancels by raising. Only files that the importers read are written, under names in Unicode's composed
    form (NFC); files that only say what was sent, such as models, become empty files. An entry that is there twice is
    written once if both are the same. On any failure, the cancellation too, the destination is removed.

    Raises `InvalidScanError` for what is no archive, is damaged or encrypted; for absolute paths, `..`,
    links, devices, one name with different contents, and names that can't be used; and for more entries, bytes or
    compression than `limits`.
    """
    limits = limits or ArchiveLimits()
    if destination.exists() and any(destination.iterdir()):
        raise FileExistsError(f"{destination} is not empty.")
    suffix = suffix_of_recording(archive)
    try:
        if suffix is not None:
            return lone_recording(archive, destination, suffix, limits)
        listing = _check_listing(archive, limits)
        destination.mkdir(parents=True, exist_ok=True)
        _write(archive, destination, listing, limits, progress)
    except BaseException:
        shutil.rmtree(destination, ignore_errors=True)
        raise
    return _scan_folder(destination)


def names_in_archive(archive: Path, limits: ArchiveLimits | None = None) -> list[str]:
    """Return the paths that an archive lists, or the name of the only file for a recording; raises as
    `extract_archive`."""
    suffix = suffix_of_recording(archive)
    if suffix is not None:
        return [f"recording{suffix}"]
    with open_reader(archive, limits or ArchiveLimits()) as reader:
        return [
            checked_path(entry.name).as_posix() for entry in reader.entries() if entry.kind is EntryKind.FILE
        ]


@dataclass(slots=True)
class _Listing:
    """The files that an archive declares: sizes in bytes, and how often each is in it; `unread` become empty files."""

    sizes: dict[PurePosixPath, int] = field(default_factory=dict)
    counts: Counter[PurePosixPath] = field(default_factory=Counter)
    unread: set[PurePosixPath] = field(default_factory=set)
    folders: set[PurePosixPath] = field(default_factory=set)

    def add(self, path: PurePosixPath, entry: Entry, limits: ArchiveLimits) -> None:
        """Note a file; raises `InvalidScanError` if it was there before with another size."""
        if self.sizes.setdefault(path, entry.size) != entry.size:
            raise InvalidScanError(_twice(path))
        if is_read(path):
            limits.check_entry(entry, is_recording=_is_recording(path))
            self.counts[path] += 1
        elif is_named(path):
            self.unread.add(path)

    @property
    def total_bytes(self) -> int:
        """All bytes that are to be unpacked."""
        return sum(self.sizes[path] * count for path, count in self.counts.items())


def _twice(path: PurePosixPath) -> str:
    return f"The archive holds {str(path)[:200]!r} twice, with different contents."


def _check_listing(archive: Path, limits: ArchiveLimits) -> _Listing:
    """Return the files to unpack with their declared sizes, after checking every entry; writes nothing."""
    listing = _Listing()
    with open_reader(archive, limits) as reader:
        for entry in reader.entries():
            path = checked_path(entry.name)
            _check_kind(entry)
            listing.folders.update(path.parents)
            if entry.kind is EntryKind.FOLDER:
                listing.folders.add(path)
            else:
                listing.add(path, entry, limits)
    written = [*listing.counts, *listing.unread]
    clash = next((path for path in written if path in listing.folders), None)
    if clash is not None:
        raise InvalidScanError(f"The archive holds {str(clash)!r} both as a file and as a folder.")
    if not written:
        raise InvalidScanError("The archive holds no images and lists of a scan.")
    limits.check_total(listing.total_bytes, archive.stat().st_size)
    return listing


def checked_path(name: str) -> PurePosixPath:
    """Return the path below the destination that an archive's entry names; `.` for the folder itself.

    Raises `InvalidScanError` for paths that are absolute, have a drive letter or `..`, and for names that are
    too long or hold control characters or bytes that are no text.
    """
    path = unicodedata.normalize("NFC", name.replace("\\", "/"))
    shown = repr(name[:200])
    if path.startswith("/") or re.match(r"[A-Za-z]:", path) or ".." in path.split("/"):
        raise InvalidScanError(f"The archive's entry {shown} leads out of the archive; use relative paths.")
    if any(ord(c) < 32 or 127 <= ord(c) < 160 or 0xD800 <= ord(c) < 0xE000 for c in path):
        raise InvalidScanError(f"The archive's entry {shown} has a name with characters that can't be used.")
    parts = [part for part in path.split("/") if part not in ("", ".")]
    longest = max((len(part.encode()) for part in parts), default=0)
    if len(path.encode()) > MAX_PATH_BYTES or longest > MAX_NAME_BYTES or len(parts) > MAX_FOLDERS:
        raise InvalidScanError(f"The archive's entry {shown} has a name that is too long or too deep.")
    if not parts and not path.startswith("."):
        raise InvalidScanError("The archive has an entry without a name.")
    return PurePosixPath(*parts)


def _check_kind(entry: Entry) -> None:
    shown = repr(entry.name[:200])
    if entry.kind is EntryKind.LINK:
        raise InvalidScanError(f"The archive's entry {shown} is a link; send the file itself.")
    if entry.kind is EntryKind.SPECIAL:
        raise InvalidScanError(f"The archive's entry {shown} is neither a file nor a folder.")
    if entry.encrypted:
        raise InvalidScanError("The archive is encrypted; send it without a password.")


def is_read(path: PurePath) -> bool:
    """Whether an importer may need a file of this path below the scan's folder."""
    known = path.suffix.lower() in NEEDED_SUFFIXES or path.name in NEEDED_NAMES
    return (known or _is_recording(path)) and not _is_hidden(path)


def _is_recording(path: PurePath) -> bool:
    name = path.name.lower()
    return path.suffix.lower() in RECORDING_SUFFIXES or name.endswith(PACKED_SUFFIXES)


def is_named(path: PurePath) -> bool:
    """Whether a file is no importer's, but its name says what was sent: it is unpacked as an empty file."""
    return path.suffix.lower() in UNREAD_SUFFIXES and not _is_hidden(path)


def _is_hidden(path: PurePath) -> bool:
    return any(part.startswith(".") or part.lower() in _OF_DESKTOPS for part in path.parts)


def _write(
    archive: Path, destination: Path, listing: _Listing, limits: ArchiveLimits, progress: Progress | None
) -> None:
    total, done = listing.total_bytes, 0
    archive_bytes = archive.stat().st_size
    for path in listing.unread:
        target = destination.joinpath(*path.parts)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.touch(exist_ok=False)
    waiting = Counter(listing.counts)
    with open_reader(archive, limits) as reader:
        for entry, stream in reader.contents(lambda entry: waiting[checked_path(entry.name)] > 0):
            path = checked_path(entry.name)
            target = destination.joinpath(*path.parts)
            target.parent.mkdir(parents=True, exist_ok=True)
            first = waiting[path] == listing.counts[path]
            waiting[path] -= 1
            step = _copy if first else _compare
            for written in step(stream, target, path, listing.sizes[path]):
                done += written
                limits.check_total(done, archive_bytes)
                if progress is not None:
                    progress(done, total)
    if waiting.total():
        raise InvalidScanError("The archive is damaged: entries that it lists are not in it.")


def _copy(stream: BinaryIO, target: Path, path: PurePosixPath, size: int) -> Iterator[int]:
    """Write a new file, yielding the bytes of each step; raises if it is not as long as declared."""
    descriptor = os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0), 0o644)
    with os.fdopen(descriptor, "wb") as file:
        for chunk in _chunks(stream, path, size):
            file.write(chunk)
            yield len(chunk)


def _compare(stream: BinaryIO, target: Path, path: PurePosixPath, size: int) -> Iterator[int]:
    """Yield the bytes of each step of reading an entry again; raises if it differs from the file written before."""
    with target.open("rb") as file:
        for chunk in _chunks(stream, path, size):
            if file.read(len(chunk)) != chunk:
                raise InvalidScanError(_twice(path))
            yield len(chunk)


def _chunks(stream: BinaryIO, path: PurePosixPath, size: int) -> Iterator[bytes]:
    """Yield an entry's bytes in pieces; raises `InvalidScanError` if they are not as many as declared."""
    done = 0
    while done <= size:
        with damage_reported():
            chunk = stream.read(_CHUNK_BYTES)
        done += len(chunk)
        if not chunk or done > size:
            break
        yield chunk
    if done != size:
        raise InvalidScanError(f"The archive's entry {path.name!r} is not as long as it declares.")


def _scan_folder(destination: Path) -> Path:
    folder = destination
    while True:
        children = list(folder.iterdir())
        if len(children) != 1 or not children[0].is_dir():
            return folder
        folder = children[0]
