"""ICL-NUIM in the TUM layout: its camera, and its axes.

Source of the layout: doc.ic.ac.uk/~ahanda/VaFRIC/iclnuim.html. Its calibration has a negative focal length along v:
y of the camera is up while x is right and z forward, so camera and world are left-handed. The scan's
examination checks it.
"""

from __future__ import annotations

from dataclasses import replace

from app.geometry.camera import Camera
from app.importers.conventions import OWN_AXES, PoseArrays, PoseConvention
from app.importers.frames import Scan

TRAJECTORY_SUFFIX = ".gt.freiburg"
AXES = "ruf"
CAMERA = Camera("PINHOLE", 640, 480, (481.2, 480.0, 319.5, 239.5))


def is_trajectory(name: str) -> bool:
    """Whether a file is a trajectory of the data set, by its name."""
    return name.lower().endswith(TRAJECTORY_SUFFIX)


def with_right_hand(scan: Scan, convention: PoseConvention) -> Scan:
    """Return the scan with poses read in the data set's axes, unless the options name others."""
    if convention.axes != OWN_AXES:
        return scan
    written = PoseArrays.of([frame.scan_from_camera for frame in scan.frames])
    poses = PoseConvention(axes=AXES).read(written).poses()
    frames = (replace(f, scan_from_camera=pose) for f, pose in zip(scan.frames, poses, strict=True))
    return replace(scan, frames=tuple(frames))
