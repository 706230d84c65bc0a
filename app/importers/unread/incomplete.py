"""Scans of which a part was not sent, known by the names of the files that were."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from app.importers.recognition import PARTS
from app.importers.unread.exports import EXPORTS

# Names that no other format has, by regular expressions of paths below a scan's folder.
SIGNS: Mapping[str, str] = {
    "stray-scanner": r"(?:odometry|camera_matrix)\.csv",
    "record3d": r"(?:rgbd/\d+\.(?:jpg|depth|conf)|depth/\d+\.exr)",
    "polycam": r"keyframes/(?:corrected_)?(?:images|cameras|depth|confidence)/[^/]+",
    "3d-scanner-app": r"(?:frame_\d+\.json|(?:depth|conf)_\d+\.png)",
    "arkitscenes": r"(?:lowres_(?:wide|depth)/[^/]+\.png|lowres_wide\.traj|lowres_wide_intrinsics/[^/]+\.pincam)",
    "kapture": r"sensors/(?:sensors|records_camera|records_depth|trajectories)\.txt",
    "colmap": r"(?:sparse/(?:0/)?)?(?:cameras|images|points3D)\.(?:txt|bin)",
    "7scenes": r"(?:seq-?\d+/)?frame-\d+\.(?:color|depth|pose)\.\w+",
    "scannet": r"intrinsic/(?:in|ex)trinsic_\w+\.txt",
    "rtabmap-export": r"[^/]*calib/[^/]+\.ya?ml",
    "tum": r"(?:depth|groundtruth|associat\w+)\.txt",
    "redwood": r"(?:camera_)?intrinsics?\.json",
}


@dataclass(frozen=True, slots=True)
class _Found:
    """A format of which files are there: how many of its parts are, and those that are not."""

    name: str
    there: int
    missing: tuple[str, ...]


def describe_incomplete(names: Sequence[str]) -> str:
    """Return a sentence on the scan of which half or more is among paths with forward slashes, nothing if none is."""
    all_found = (item for name in SIGNS if (item := _parts(name, names)) is not None)
    found = [item for item in all_found if item.missing and item.there >= len(item.missing)]
    if not found:
        return ""
    # Of formats with as many parts there, the one that lacks least.
    best = max(found, key=lambda item: (item.there, -len(item.missing)))
    export = EXPORTS[best.name]
    missing = ", ".join(best.missing[:-1]) + (" and " if best.missing[1:] else "") + best.missing[-1]
    are = "are" if best.missing[1:] else "is"
    return f"This looks like {export.title}, and {missing} {are} missing: {export.remedy}."


def _parts(name: str, names: Sequence[str]) -> _Found | None:
    sign = re.compile(rf"((?:.*?/)??){SIGNS[name]}", re.IGNORECASE)
    folder = next((match.group(1) for path in names if (match := sign.fullmatch(path))), None)
    if folder is None:
        return None
    below = [path.removeprefix(folder) for path in names if path.startswith(folder)]
    is_there = {
        shown: any(re.fullmatch(pattern, path, re.IGNORECASE) for path in below)
        for shown, pattern in PARTS[name]
    }
    return _Found(
        name, sum(is_there.values()), tuple(shown for shown, there in is_there.items() if not there)
    )
