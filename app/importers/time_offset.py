"""Frames whose poses are taken at another time than their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from app.errors import InvalidScanError
from app.importers.association import Trajectory
from app.importers.frames import Scan


def with_time_offset(scan: Scan, offset_s: float) -> Scan:
    """Return the scan in which each frame has the pose of its time plus an offset, between those of its frames.

    Frames for whose time there is no pose are discarded as `no_pose`. Raises `InvalidScanError` when none is left.
    """
    times_s = np.array([frame.timestamp_s for frame in scan.frames])
    positions = np.stack([frame.scan_from_camera.translation for frame in scan.frames])
    quaternions = np.stack([frame.scan_from_camera.quaternion for frame in scan.frames])
    track = Trajectory.from_rows(np.column_stack([times_s, positions, quaternions]))
    moved = track.moved(offset_s)
    poses = [moved.pose_at(time_s, 0.0) for time_s in times_s.tolist()]
    frames = tuple(
        replace(frame, scan_from_camera=pose)
        for frame, pose in zip(scan.frames, poses, strict=True)
        if not isinstance(pose, str)
    )
    if not frames:
        raise InvalidScanError(f"With time_offset_s {offset_s:g} no frame has a pose.")
    lost = tuple(frame.name for frame, pose in zip(scan.frames, poses, strict=True) if isinstance(pose, str))
    no_pose = (*scan.discarded.get("no_pose", ()), *lost)
    return replace(
        scan, frames=frames, discarded={**scan.discarded, **({"no_pose": no_pose} if no_pose else {})}
    )
