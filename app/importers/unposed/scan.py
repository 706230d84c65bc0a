"""What a scan without camera poses is before its poses are estimated from the pictures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from app.geometry.camera_hint import CameraHint
from app.importers.frames import Scan
from app.importers.unposed.recording import RecordedFrame


@dataclass(frozen=True, slots=True, kw_only=True)
class UnposedScan:
    """Pictures whose poses have to be estimated: those of a `video`, `photos`, or the frames of `listed`.

    Exactly one of the three is there. The poses in `listed` mean nothing. `camera` is that of the options; None
    where it is to be found from the photos' tags or from the pictures themselves. `scratch` is as in `ScanOptions`.
    `recorded` are the frames of a recording, one for each of `photos`, which then follow each other in time.
    """

    format: str
    video: Path | None = None
    photos: tuple[Path, ...] = ()
    recorded: tuple[RecordedFrame, ...] = ()
    listed: Scan | None = None
    camera: CameraHint | None = None
    scratch: Path | None = None
