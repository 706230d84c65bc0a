"""What a build left out of a scan, as its report shows it: how many frames, why, and pictures of some."""

from __future__ import annotations

from dataclasses import dataclass

from app.errors import NotFoundError
from app.services.resources import Resources
from app.storage.maps import KeptFrame, get_map, list_left_out


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOutGroup:
    """The frames that were left out for one reason: their number, the names of the first, and the numbers of those
    with a picture, with the frames themselves."""

    reason: str
    frames: int
    names: list[str]
    pictures: list[tuple[int, KeptFrame]]


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOut:
    """What was left out of the scan of `frames` frames, None if that isn't known; `replaced` have a frame in place."""

    frames: int | None
    replaced: int
    groups: list[LeftOutGroup]


def left_out_of(resources: Resources, venue: str, version: int) -> LeftOut:
    """Return what the build of a map version left out, most frames first; raises `NotFoundError`."""
    with resources.database.read() as connection:
        report = get_map(connection, venue, version).statistics
        kept = list(enumerate(list_left_out(connection, venue, version)))
    names = report.get("discarded_frames") or {}
    counts = {reason: number for reason, number in (report.get("discarded") or {}).items() if number}
    groups = [
        LeftOutGroup(
            reason=reason,
            frames=number,
            names=names.get(reason, []),
            pictures=[(row, frame) for row, frame in kept if frame.reason == reason],
        )
        for reason, number in sorted(counts.items(), key=lambda each: -each[1])
    ]
    return LeftOut(frames=report.get("frames"), replaced=len(report.get("replaced") or {}), groups=groups)


def left_out_picture_blob(resources: Resources, venue: str, version: int, number: int) -> str:
    """Return the digest of the picture of a frame that was left out; raises `NotFoundError`."""
    with resources.database.read() as connection:
        get_map(connection, venue, version)
        kept = list_left_out(connection, venue, version)
    if number >= len(kept):
        raise NotFoundError(f"Map version {version} has no picture {number} of a frame that was left out.")
    return kept[number].picture_blob
