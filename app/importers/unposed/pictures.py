"""`video`, `images` and `recording`: pictures without poses, found among the files that were sent."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path, PurePath, PurePosixPath

from app.errors import InvalidScanError
from app.importers.frames import ScanOptions
from app.importers.phones.video import open_video
from app.importers.unposed.recording import is_recording, read_recording
from app.importers.unposed.scan import UnposedScan
from app.importers.unread.single_files import ARCHIVE_SUFFIXES

FORMATS = ("video", "images", "recording")
VIDEO_SUFFIXES = frozenset({".mp4", ".mov", ".m4v", ".mkv", ".avi", ".webm"})
PHOTO_SUFFIXES = frozenset(
    {".jpg", ".jpeg", ".jpe", ".png", ".webp", ".heic", ".heif", ".avif", ".tif", ".tiff"}
)
# Fewer photos are somebody's attachment, not a scan.
MIN_PHOTOS = 3


def format_of_names(names: Iterable[str]) -> str | None:
    """Return `recording` for frames with their list, `video` for the only file if it is one, `images` for photos in one
    folder and nothing else, else None."""
    paths = [PurePath(name) for name in names]
    if is_recording([PurePosixPath(path.as_posix()) for path in paths]):
        return "recording"
    suffixes = {path.suffix.lower() for path in paths}
    if len(paths) == 1 and suffixes <= VIDEO_SUFFIXES:
        return "video"
    one_folder = len({path.parent for path in paths}) == 1
    return "images" if len(paths) >= MIN_PHOTOS and suffixes <= PHOTO_SUFFIXES and one_folder else None


def open_pictures(directory: Path, name: str, options: ScanOptions) -> UnposedScan:
    """Return the video, the photos or the recording below a folder; `name` is one of `FORMATS`.

    Raises `InvalidScanError` when there is none, when there are several videos, and for a video that can't be decoded.
    """
    if name == "recording":
        folder, recorded = read_recording(directory)
        return UnposedScan(
            format=name,
            photos=tuple(folder / frame.name for frame in recorded),
            recorded=recorded,
            camera=options.camera,
            scratch=options.scratch,
        )
    files = _files(directory)
    if name == "video":
        videos = [path for path in files if path.suffix.lower() in VIDEO_SUFFIXES]
        if len(videos) != 1:
            found = ", ".join(path.name for path in videos[:3]) or "none"
            raise InvalidScanError(
                f"A scan of the format video holds one video; there are {len(videos)}: {found}."
            )
        open_video(videos[0])
        return UnposedScan(format=name, video=videos[0], camera=options.camera, scratch=options.scratch)
    photos = tuple(path for path in files if path.suffix.lower() in PHOTO_SUFFIXES)
    if len(photos) < MIN_PHOTOS:
        raise InvalidScanError(
            f"A scan of the format images holds photos, {MIN_PHOTOS} or more; there are {len(photos)}."
        )
    return UnposedScan(format=name, photos=photos, camera=options.camera, scratch=options.scratch)


def summary_of(scan: UnposedScan) -> str:
    """Return a sentence on what a video or photos are."""
    if scan.recorded:
        return f"These are {len(scan.recorded)} frames that a phone recorded."
    if scan.video is None:
        return f"These are {len(scan.photos)} photos."
    video = open_video(scan.video)
    length = f", {video.count / video.fps:.0f} s" if video.count and video.fps else ""
    return f"{video.path.name} is a video of {video.width} x {video.height} pixels{length}."


def find_format(directory: Path) -> str | None:
    """Return what the files below a folder are by their names, as `format_of_names`."""
    return format_of_names(path.relative_to(directory).as_posix() for path in _files(directory))


def _files(directory: Path) -> list[Path]:
    """Return the files below a folder in the order of their paths, without links, hidden files and archives."""
    found = (path for path in directory.rglob("*") if path.is_file() and not path.is_symlink())
    return sorted(
        path
        for path in found
        if not path.name.startswith(".") and path.suffix.lower() not in ARCHIVE_SUFFIXES
    )
