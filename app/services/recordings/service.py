"""Recordings: a phone's frames, stored one by one as they are filmed, then built like any other scan."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import timedelta
from typing import Any, BinaryIO, cast

from app.engine.mapping.options import parse_build_options
from app.errors import ConflictError, NotFoundError, UnsupportedImageError
from app.importers.unposed.recording import Down, RecordingWriter
from app.limits import limit
from app.services.resources import Resources
from app.services.submit_build import UPLOAD_PREFIX, submit_build
from app.storage.builds import Build, get_build
from app.storage.db import hold_blobs, now
from app.storage.recordings import (
    Recording,
    Stored,
    StoredFrame,
    add_frame,
    create_recording,
    delete_recording,
    get_recording,
    list_frames,
    stored,
    sweep_recordings,
    touch,
)
from app.storage.sweep import discard_blobs
from app.vision.images import decode_image

JPEG_START = b"\xff\xd8\xff"


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingOptions:
    """How much a recording holds, and for how long it is kept."""

    max_frames: int = limit(
        1500,
        "Frames of a recording.",
        chosen="By hand: twice as many as a reconstruction takes; a page that films chooses far fewer.",
    )
    kept_h: float = limit(
        72.0,
        "Hours after which a recording that nobody goes on with is deleted.",
        chosen="By hand: a phone without network gets home, and a weekend passes.",
    )
    shown_missing: int = limit(
        20, "Missing frames that an answer lists.", chosen="By hand: the page sends all that it has anyway."
    )


OPTIONS = RecordingOptions()


@dataclass(frozen=True, slots=True)
class RecordingState:
    """A recording, how much of it is stored, and the newest build of it."""

    recording: Recording
    stored: Stored
    build: Build | None


class RecordingService:
    """Takes recordings. Safe to share between threads."""

    def __init__(self, resources: Resources) -> None:
        self._resources = resources

    def begin(self, venue_id: str) -> RecordingState:
        """Begin a recording; raises `NotFoundError` for an unknown venue."""
        with self._resources.database.write() as connection:
            recording = create_recording(connection, venue_id)
        return RecordingState(recording, Stored(0, 0, ()), None)

    def add(self, recording_id: str, number: int, picture: bytes, time_s: float, down: Down | None) -> None:
        """Store a frame, a JPEG; the same one sent again is no error.

        Raises `NotFoundError`, `InvalidImageError`, and `ConflictError` for another picture of the same number and for
        a recording that is full or being built.
        """
        if number >= OPTIONS.max_frames:
            raise ConflictError(f"A recording has at most {OPTIONS.max_frames} frames: end it and build.")
        if not picture.startswith(JPEG_START):
            raise UnsupportedImageError("A frame of a recording must be a JPEG.")
        decode_image(picture, self._resources.settings.max_image_pixels)
        digest = self._resources.blobs.put(picture)
        frame = StoredFrame(number=number, picture_blob=digest, bytes=len(picture), time_s=time_s, down=down)
        with self._resources.database.write() as connection:
            recording = get_recording(connection, recording_id)
            build = None if recording.build_id is None else get_build(connection, recording.build_id)
            if build is not None and (not build.ended or build.state == "succeeded"):
                raise ConflictError("This recording has ended; begin another one.")
            hold_blobs(connection)
            if not self._resources.blobs.contains(digest):
                self._resources.blobs.put(picture)
            add_frame(connection, recording_id, frame)

    def state(self, recording_id: str) -> RecordingState:
        """Return how far a recording is; raises `NotFoundError`."""
        with self._resources.database.read() as connection:
            recording = get_recording(connection, recording_id)
            build = None
            if recording.build_id is not None:
                with suppress(NotFoundError):
                    build = get_build(connection, recording.build_id)
            return RecordingState(recording, stored(connection, recording_id), build)

    def finish(self, recording_id: str, frames: int, options: Mapping[str, Any]) -> str:
        """Queue a build of a recording that has `frames` frames, and return the build's id.

        A recording that is being built, or has become a map, keeps that build; one whose build has failed is built
        again, with these options. Raises `NotFoundError`, `InvalidInputError` for options that can't be meant, and
        `ConflictError` where frames are missing.
        """
        given = {"format": "recording", **options}
        parse_build_options(given)
        state = self.state(recording_id)
        before = state.build
        if before is not None and (not before.ended or before.state == "succeeded"):
            return before.id
        after = state.stored.frames + len(state.stored.missing)
        absent = [*state.stored.missing, *range(after, frames)]
        if absent:
            listed = ", ".join(str(number) for number in absent[: OPTIONS.shown_missing])
            raise ConflictError(
                f"Of {frames} frames {state.stored.frames} are stored. Missing are: {listed}."
            )
        # One build for each time that a recording is ended, however often the call is repeated.
        key = recording_id if before is None else before.id
        with tempfile.NamedTemporaryFile(dir=self._resources.scratch_dir, prefix=UPLOAD_PREFIX) as file:
            archive = cast("BinaryIO", file)
            self._write(recording_id, archive)
            archive.seek(0)
            build_id = submit_build(self._resources, state.recording.venue_id, given, archive, key)
        with self._resources.database.write() as connection:
            touch(connection, recording_id, build_id=build_id)
        return build_id

    def discard(self, recording_id: str) -> None:
        """Delete a recording; a map that was made of it stays. Raises `NotFoundError`."""
        with self._resources.database.write() as connection:
            blobs = delete_recording(connection, recording_id)
        discard_blobs(self._resources.database, self._resources.blobs, blobs)

    def _write(self, recording_id: str, file: BinaryIO) -> None:
        with self._resources.database.read() as connection:
            frames = list_frames(connection, recording_id)
        writer = RecordingWriter(file)
        for frame in frames:
            writer.add(frame.number, self._resources.blobs.get(frame.picture_blob), frame.time_s, frame.down)
        writer.close()


def drop_old_recordings(resources: Resources) -> None:
    """Delete recordings that nobody goes on with, and the frames of those that have become a map."""
    with resources.database.write() as connection:
        blobs = sweep_recordings(connection, now() - timedelta(hours=OPTIONS.kept_h))
    if blobs:
        discard_blobs(resources.database, resources.blobs, blobs)
