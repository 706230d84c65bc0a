"""Reading zip and tar archives that nobody vouches for, with bounds on what the reading itself may cost."""

from __future__ import annotations

import bz2
import gzip
import lzma
import stat
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum, auto
from pathlib import Path
from typing import IO, BinaryIO, Protocol, cast

from app.errors import InvalidScanError
from app.importers.archives.xz_stream import XzStream, check_zip_dictionary
from app.importers.archives.zip_names import zip_name
from app.importers.archives.zip_parts import is_last_part
from app.importers.unread.single_files import SPLIT, refuse_single_file
from app.limits import limit

MIB = 1024 * 1024


@dataclass(frozen=True, slots=True, kw_only=True)
class HeaderLimits:
    """How much an archive may spend on describing its entries."""

    directory_bytes_per_entry: int = limit(
        200,
        "What a zip's table of contents may hold for each entry.",
        chosen="By hand: a record of 46 bytes, a path, and the extra fields that common packers add.",
    )
    header_bytes_per_entry: int = limit(
        4096,
        "What a tar's headers may hold for each entry.",
        chosen="By hand: a header of 512 bytes, and several times that for long names and extended attributes.",
    )
    max_global_headers: int = limit(
        64, "Header fields that hold for all entries of a tar.", chosen="By hand: git archive writes one."
    )


_HEADERS = HeaderLimits()


_DAMAGE = (
    "The archive is damaged or was cut off, or is one part of several; pack and send it again, as one file."
)
_DAMAGED = (
    zipfile.BadZipFile,
    tarfile.TarError,
    zlib.error,
    lzma.LZMAError,
    struct.error,
    EOFError,
    RecursionError,
    UnicodeError,
    ValueError,
    KeyError,
    IndexError,
    OverflowError,
)


class EntryKind(Enum):
    """What an entry of an archive would become."""

    FILE = auto()
    FOLDER = auto()
    LINK = auto()
    SPECIAL = auto()


@dataclass(frozen=True, slots=True)
class Entry:
    """One entry as the archive declares it; `compressed_size` is None in formats that compress as a whole."""

    name: str
    size: int
    compressed_size: int | None
    kind: EntryKind
    encrypted: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class ArchiveLimits:
    """How much an archive may hold, and how much smaller than its contents it may be.

    Compression beyond `max_ratio` is accepted up to `ratio_free_bytes`: lists of numbers and blank images
    shrink a lot, but no scan does as a whole.
    """

    max_total_bytes: int = limit(
        20 * 1024 * MIB,
        "Bytes of all files together, unpacked.",
        chosen="By hand: an hour of frames at 2 Hz is 10 GB; ROOMFIX_MAX_UNPACKED_BYTES sets it.",
    )
    max_entries: int = limit(
        200_000, "Files and folders.", chosen="By hand: an hour of frames at 15 Hz, three files each."
    )
    max_entry_bytes: int = limit(
        256 * MIB,
        "Bytes of one file, unpacked.",
        chosen="By hand: 50 megapixels of colour without compression are 150 MB.",
    )
    max_recording_bytes: int = limit(
        16 * 1024 * MIB,
        "Bytes of one recording, such as a video, a bag or a database, unpacked.",
        chosen="By hand: ten minutes of colour and depth without compression at 640 x 480 and 30 Hz.",
    )
    max_ratio: float = limit(
        200.0,
        "How many times its size an archive, or an entry of it, may unpack to.",
        chosen="By hand: text of a list shrinks 10 times, a blank depth image 150 times.",
    )
    ratio_free_bytes: int = limit(
        50 * MIB, "Up to this, unpacked, no ratio counts.", chosen="By hand: what harms no server."
    )

    def check_count(self, count: int) -> None:
        """Raise `InvalidScanError` if an archive of this many entries is too large."""
        if count > self.max_entries:
            raise InvalidScanError(
                f"The archive has more than {self.max_entries} entries, which is the limit."
            )

    def check_entry(self, entry: Entry, *, is_recording: bool = False) -> None:
        """Raise `InvalidScanError` if the entry declares too much, alone or against its compressed size."""
        largest = self.max_recording_bytes if is_recording else self.max_entry_bytes
        if entry.size < 0:
            raise InvalidScanError(f"The archive is damaged: {entry.name[:200]!r} has a negative size.")
        if entry.size > largest:
            raise InvalidScanError(
                f"The archive's entry {entry.name[:200]!r} has {entry.size / MIB:.0f} MB unpacked; the limit "
                f"for one file is {largest / MIB:.0f} MB."
            )
        if entry.compressed_size is not None and self._is_bomb(entry.size, entry.compressed_size):
            raise InvalidScanError(
                f"The archive's entry {entry.name[:200]!r} unpacks to more than {self.max_ratio:g} times "
                "its size."
            )

    def check_total(self, unpacked_bytes: int, archive_bytes: int) -> None:
        """Raise `InvalidScanError` if the contents are too large, alone or against the archive's own size."""
        if unpacked_bytes > self.max_total_bytes:
            raise InvalidScanError(
                f"The archive unpacks to more than {self.max_total_bytes / MIB:.0f} MB, the limit."
            )
        if self._is_bomb(unpacked_bytes, archive_bytes):
            raise InvalidScanError(f"The archive unpacks to more than {self.max_ratio:g} times its size.")

    def _is_bomb(self, unpacked_bytes: int, packed_bytes: int) -> bool:
        return unpacked_bytes > max(self.ratio_free_bytes, self.max_ratio * packed_bytes)


class ArchiveReader(Protocol):
    """An open archive, to be gone through once."""

    def entries(self) -> Iterator[Entry]:
        """Yield what the archive lists; raises `InvalidScanError` past the limits on entries and headers."""

    def contents(self, wanted: Callable[[Entry], bool]) -> Iterator[tuple[Entry, BinaryIO]]:
        """Yield the wanted files with a stream of their bytes, to be read before the next is asked for."""


@contextmanager
def open_reader(archive: Path, limits: ArchiveLimits) -> Iterator[ArchiveReader]:
    """Open a zip or tar archive, told apart by its contents; raises `InvalidScanError` for anything else."""
    with archive.open("rb") as file:
        with damage_reported():
            reader = _reader(file, archive.stat().st_size, limits)
        yield reader


@contextmanager
def damage_reported() -> Iterator[None]:
    """Turn whatever a damaged archive makes the libraries raise into an `InvalidScanError`."""
    try:
        yield
    except NotImplementedError:
        raise InvalidScanError(
            "The archive uses a compression that is not known; use deflate or gzip."
        ) from None
    except _DAMAGED:
        raise InvalidScanError(_DAMAGE) from None
    except OSError as error:
        # gzip and bz2 report damage as an OSError without a number, unlike the file system.
        if error.errno is not None:
            raise
        raise InvalidScanError(_DAMAGE) from None


def _reader(file: BinaryIO, archive_bytes: int, limits: ArchiveLimits) -> ArchiveReader:
    head = file.read(512)
    file.seek(0)
    if head.startswith((b"PK\x03\x04", b"PK\x05\x06")):
        if is_last_part(file):
            raise InvalidScanError(f"The upload is {SPLIT}.")
        return _ZipReader(file, limits)
    for magic, opener in (
        (b"\x1f\x8b", gzip.open),
        (b"BZh", bz2.open),
        (b"\xfd7zXZ\x00", XzStream),
    ):
        if head.startswith(magic):
            return _tar_in(cast(IO[bytes], opener(file)), archive_bytes, limits)
    # Before POSIX a tar file had no magic number; what is none fails on its checksum.
    if head[257:262] != b"ustar" and not _has_tar_checksum(head):
        refuse_single_file(head)
        raise InvalidScanError(
            "The upload is not an archive, nor a recording or video that is read: send a zip, tar, tar.gz, tar.xz or "
            "tar.bz2 file, or a .bag, .mcap, .db3, .db, .sens, .mp4, .mov, .mkv, .avi or .webm file as it is."
        )
    return _TarReader(file, archive_bytes, limits)


def _tar_in(stream: IO[bytes], archive_bytes: int, limits: ArchiveLimits) -> ArchiveReader:
    try:
        return _TarReader(stream, archive_bytes, limits)
    except tarfile.ReadError:
        raise InvalidScanError(
            "The upload is compressed and holds no tar archive, or it is damaged: unpack it, and send what is in it."
        ) from None


def _has_tar_checksum(header: bytes) -> bool:
    try:
        declared = int(header[148:156].strip(b"\x00 ") or b"-1", 8)
    except ValueError:
        return False
    return len(header) == 512 and declared == sum(header) - sum(header[148:156]) + 8 * 32


class _ZipReader:
    def __init__(self, file: BinaryIO, limits: ArchiveLimits) -> None:
        longest = MIB + _HEADERS.directory_bytes_per_entry * limits.max_entries
        self._file = file
        self._zip = zipfile.ZipFile(cast(IO[bytes], _BoundedReads(file, longest)))
        self._limits = limits

    def entries(self) -> Iterator[Entry]:
        infos = self._zip.infolist()
        self._limits.check_count(len(infos))
        return (_entry_of_zip(info) for info in infos)

    def contents(self, wanted: Callable[[Entry], bool]) -> Iterator[tuple[Entry, BinaryIO]]:
        for info in self._zip.infolist():
            entry = _entry_of_zip(info)
            if entry.kind is EntryKind.FILE and wanted(entry):
                with damage_reported():
                    check_zip_dictionary(self._file, info)
                    stream = self._zip.open(info)
                with stream:
                    yield entry, cast(BinaryIO, stream)


def _entry_of_zip(info: zipfile.ZipInfo) -> Entry:
    # `filename` ends at the first NUL; the name as it was written shows what it hides.
    name = zip_name(info)
    kind = EntryKind.FOLDER if name.endswith(("/", "\\")) else EntryKind.FILE
    mode = stat.S_IFMT(info.external_attr >> 16)
    if mode == stat.S_IFLNK:
        kind = EntryKind.LINK
    elif mode not in (0, stat.S_IFREG, stat.S_IFDIR):
        kind = EntryKind.SPECIAL
    encrypted = bool(info.flag_bits & 0x41)
    return Entry(name, info.file_size, info.compress_size, kind, encrypted)


class _TarReader:
    def __init__(self, stream: IO[bytes], archive_bytes: int, limits: ArchiveLimits) -> None:
        self._stream = _ForwardReads(stream, archive_bytes, limits)
        self._tar = tarfile.TarFile(fileobj=cast(IO[bytes], self._stream))
        self._limits = limits

    def entries(self) -> Iterator[Entry]:
        return (_entry_of_tar(member) for member in self._members())

    def contents(self, wanted: Callable[[Entry], bool]) -> Iterator[tuple[Entry, BinaryIO]]:
        for member in self._members():
            entry = _entry_of_tar(member)
            if entry.kind is EntryKind.FILE and wanted(entry):
                stream = self._tar.extractfile(member)
                if stream is not None:
                    self._stream.in_header = False
                    yield entry, cast(BinaryIO, stream)
                    self._stream.in_header = True

    def _members(self) -> Iterator[tarfile.TarInfo]:
        count = 0
        while True:
            with damage_reported():
                member = self._tar.next()
            if member is None:
                self._check_end()
                return
            count += 1
            self._limits.check_count(count)
            self._stream.entries = count
            if len(self._tar.pax_headers) > _HEADERS.max_global_headers:
                raise InvalidScanError("The archive has more header fields than a scan's archive has.")
            yield member
            # The library keeps every header; they are needed once.
            self._tar.members = []  # type: ignore[attr-defined]

    def _check_end(self) -> None:
        # The library takes a header that it can't read for the end of the archive; the true end is zeros.
        if any(self._stream.last_header):
            raise InvalidScanError(_DAMAGE)
        # Compressed streams carry their checksum at the end.
        with damage_reported():
            self._stream.skip_to_end()


def _entry_of_tar(member: tarfile.TarInfo) -> Entry:
    kind = EntryKind.SPECIAL
    if member.isdir():
        kind = EntryKind.FOLDER
    elif member.issym() or member.islnk():
        kind = EntryKind.LINK
    elif member.isreg() and not member.issparse():
        kind = EntryKind.FILE
    return Entry(member.name, member.size, None, kind)


class _BoundedReads:
    """A file that refuses to read much at once: a zip's directory is read in one piece before it is seen."""

    def __init__(self, file: BinaryIO, longest_read: int) -> None:
        self._file, self._longest = file, longest_read

    def read(self, size: int = -1) -> bytes:
        if size > self._longest:
            raise InvalidScanError("The archive has a longer table of contents than a scan's archive has.")
        # The library reads to the end only from the last 64 KB.
        return self._file.read(self._longest if size < 0 else size)

    def seek(self, offset: int, whence: int = 0) -> int:
        if whence == 0 and offset < 0:
            raise zipfile.BadZipFile("an offset before the start")
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        return self._file.tell()

    def seekable(self) -> bool:
        return True


class _ForwardReads:
    """The unpacked stream of a tar file: counts bytes, refuses to go back, bounds what headers may take."""

    def __init__(self, stream: IO[bytes], archive_bytes: int, limits: ArchiveLimits) -> None:
        self._stream, self._archive_bytes, self._limits = stream, archive_bytes, limits
        self._position = 0
        self._header_bytes = 0
        self.entries = 0
        self.in_header = True
        self.last_header = b""

    def read(self, size: int = -1) -> bytes:
        if self.in_header:
            self._header_bytes += max(size, 0)
            if size < 0 or self._header_bytes > MIB + _HEADERS.header_bytes_per_entry * self.entries:
                raise InvalidScanError("The archive has longer headers than a scan's archive has.")
        data = self._stream.read(size)
        if self.in_header:
            self.last_header = data
        self._position += len(data)
        self._limits.check_total(self._position, self._archive_bytes)
        return data

    def seek(self, offset: int, whence: int = 0) -> int:
        if whence != 0 or offset < self._position:
            raise InvalidScanError("The archive is damaged: its entries overlap.")
        while self._position < offset and self._skip(min(MIB, offset - self._position)):
            pass
        return self._position

    def skip_to_end(self) -> None:
        while self._skip(MIB):
            pass

    def _skip(self, size: int) -> int:
        skipped = len(self._stream.read(size))
        self._position += skipped
        self._limits.check_total(self._position, self._archive_bytes)
        return skipped

    def tell(self) -> int:
        return self._position

    def seekable(self) -> bool:
        return True
