"""Unpacking an uploaded scan: everything is checked before anything is written, and again while writing."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Iterable
from pathlib import Path, PurePosixPath
from typing import BinaryIO

from app.errors import InvalidScanError
from app.importers.archive_readers import ArchiveLimits, Entry, EntryKind, damage_reported, open_reader

# What the importers read. Anything else in an archive, from thumbnails to recordings, stays in it.
NEEDED_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".txt", ".csv", ".json"})
ARCHIVE_SUFFIXES = frozenset({".zip", ".tar", ".tgz", ".gz", ".xz", ".bz2", ".7z", ".rar"})

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

    Zip and tar (plain, gzip, xz or bzip2) are told apart by their contents. `destination` must not exist or
    be empty. `progress(done_bytes, total_bytes)` is called while writing; it cancels by raising. Only files
    that the importers read are written. On any failure, the cancellation too, the destination is removed.

    Raises `InvalidScanError` for what is no archive, is damaged or encrypted; for absolute paths, `..`,
    links, devices, duplicates and names that can't be used; and for more entries, bytes or compression than
    `limits`.
    """
    limits = limits or ArchiveLimits()
    if destination.exists() and any(destination.iterdir()):
        raise FileExistsError(f"{destination} is not empty.")
    try:
        files = _check_listing(archive, limits)
        destination.mkdir(parents=True, exist_ok=True)
        _write(archive, destination, files, limits, progress)
    except BaseException:
        shutil.rmtree(destination, ignore_errors=True)
        raise
    return _scan_folder(destination)


def _check_listing(archive: Path, limits: ArchiveLimits) -> dict[PurePosixPath, int]:
    """Return the files to unpack with their declared sizes, after checking every entry; writes nothing."""
    files: dict[PurePosixPath, int] = {}
    seen: set[PurePosixPath] = set()
    folders: set[PurePosixPath] = set()
    others: set[str] = set()
    with open_reader(archive, limits) as reader:
        for entry in reader.entries():
            path = checked_path(entry.name)
            _check_kind(entry)
            folders.update(path.parents)
            if entry.kind is EntryKind.FOLDER:
                folders.add(path)
                continue
            if path in seen:
                raise InvalidScanError(f"The archive holds {entry.name[:200]!r} twice.")
            seen.add(path)
            if _is_needed(path):
                limits.check_entry(entry)
                files[path] = entry.size
            else:
                others.add(path.suffix.lower())
    clash = next((path for path in files if path in folders), None)
    if clash is not None:
        raise InvalidScanError(f"The archive holds {str(clash)!r} both as a file and as a folder.")
    if not files:
        raise InvalidScanError(_nothing_needed(others))
    limits.check_total(sum(files.values()), archive.stat().st_size)
    return files


def _nothing_needed(suffixes: Iterable[str]) -> str:
    if ARCHIVE_SUFFIXES.intersection(suffixes):
        return "The archive holds other archives: unpack those first, and send one archive of their files."
    return "The archive holds no images and lists of a scan."


def checked_path(name: str) -> PurePosixPath:
    """Return the path below the destination that an archive's entry names; `.` for the folder itself.

    Raises `InvalidScanError` for paths that are absolute, have a drive letter or `..`, and for names that are
    too long or hold control characters or bytes that are no text.
    """
    path = name.replace("\\", "/")
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


def _is_needed(path: PurePosixPath) -> bool:
    hidden = any(part.startswith(".") or part == "__MACOSX" for part in path.parts)
    return not hidden and path.suffix.lower() in NEEDED_SUFFIXES


def _write(
    archive: Path,
    destination: Path,
    files: dict[PurePosixPath, int],
    limits: ArchiveLimits,
    progress: Progress | None,
) -> None:
    total, done = sum(files.values()), 0
    archive_bytes = archive.stat().st_size
    waiting = dict(files)
    with open_reader(archive, limits) as reader:
        for entry, stream in reader.contents(lambda entry: checked_path(entry.name) in waiting):
            path = checked_path(entry.name)
            size = waiting.pop(path)
            target = destination.joinpath(*path.parts)
            target.parent.mkdir(parents=True, exist_ok=True)
            for written in _copy(stream, target, size):
                done += written
                limits.check_total(done, archive_bytes)
                if progress is not None:
                    progress(done, total)
    if waiting:
        raise InvalidScanError("The archive is damaged: entries that it lists are not in it.")


def _copy(stream: BinaryIO, target: Path, size: int) -> Iterable[int]:
    """Write a new file, yielding the bytes of each step; raises if it is not as long as declared."""
    written = 0
    descriptor = os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0), 0o644)
    with os.fdopen(descriptor, "wb") as file:
        while written <= size:
            with damage_reported():
                chunk = stream.read(_CHUNK_BYTES)
            written += len(chunk)
            if not chunk or written > size:
                break
            file.write(chunk)
            yield len(chunk)
    if written != size:
        raise InvalidScanError(f"The archive's entry {target.name!r} is not as long as it declares.")


def _scan_folder(destination: Path) -> Path:
    folder = destination
    while True:
        children = list(folder.iterdir())
        if len(children) != 1 or not children[0].is_dir():
            return folder
        folder = children[0]
