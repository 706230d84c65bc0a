"""A scan's format by the names of its files alone: the directory of an archive, before it has travelled."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from app.importers.unposed.pictures import format_of_names
from app.importers.unposed.recording import LIST_NAME

# What a format's files are called, by regular expressions of paths below the scan's folder. The first is what the
# format is known by; the others are what a scan of it needs too. None needs depth.
Part = tuple[str, str]
PARTS: Mapping[str, tuple[Part, ...]] = {
    "stray-scanner": (
        ("odometry.csv", r"odometry\.csv"),
        ("camera_matrix.csv", r"camera_matrix\.csv"),
        ("rgb.mp4", r"rgb\.(?:mp4|mov)"),
    ),
    "record3d": (
        ("metadata", r"(?:[^/]+\.r3d|metadata(?:\.json)?)"),
        ("rgbd/0.jpg", r"(?:[^/]+\.r3d|(?:rgbd|rgb|color)/\d+\.(?:jpe?g|png))"),
    ),
    "polycam": (
        ("keyframes/cameras", r"(?:keyframes/(?:corrected_)?cameras/[^/]+|(?:corrected_)?cameras/\d+)\.json"),
        ("keyframes/images", r"(?:keyframes/)?(?:corrected_)?images/[^/]+\.(?:jpe?g|png)"),
    ),
    "3d-scanner-app": (
        ("frame_00000.json", r"frame_\d+\.json"),
        ("frame_00000.jpg", r"frame_\d+\.jpe?g"),
    ),
    "arkitscenes": (
        ("lowres_wide", r"lowres_wide/[^/]+\.(?:png|jpg)"),
        ("lowres_wide.traj", r"lowres_wide\.traj"),
        ("lowres_wide_intrinsics", r"lowres_wide_intrinsics/[^/]+\.pincam"),
    ),
    "nerfstudio": (("transforms.json", r"transforms\.json"),),
    "kapture": (
        ("sensors/sensors.txt", r"sensors/sensors\.txt"),
        ("sensors/records_camera.txt", r"sensors/records_camera\.txt"),
        ("sensors/trajectories.txt", r"sensors/trajectories\.txt"),
    ),
    "colmap": (
        ("cameras.txt or cameras.bin", r"(?:sparse/(?:0/)?|colmap/)?cameras\.(?:txt|bin)"),
        ("images.txt or images.bin", r"(?:sparse/(?:0/)?|colmap/)?images\.(?:txt|bin)"),
        ("images", r"(?:images?|rgb|color|resized_images)/.+\.(?:jpe?g|png)"),
    ),
    "12scenes": (
        ("info.txt", r"_?info\.txt"),
        ("data/frame-000000.color.jpg", r"(?:data/|sequence/)?frame-\d+\.color\.(?:jpg|png)"),
    ),
    "7scenes": (
        ("frame-000000.color.png", r"frame-\d+\.color\.(?:png|jpe?g)"),
        ("frame-000000.pose.txt", r"frame-\d+\.pose\.txt"),
    ),
    "tum": (
        ("rgb.txt", r"(?:rgb|associat\w+)\.txt"),
        ("groundtruth.txt", r"(?:groundtruth\.txt|[^/]*traj[^/]*\.txt|[^/]+\.freiburg)"),
    ),
    "scannet": (
        ("intrinsic", r"intrinsic/intrinsic_color\.txt"),
        ("color", r"color/\d+\.(?:jpe?g|png)"),
        ("pose", r"pose/\d+\.txt"),
    ),
    "rtabmap-export": (
        ("calib", r"[^/]*calib/[^/]+\.ya?ml"),
        ("rgb", r"[^/]*rgb/[^/]+\.(?:jpg|png)"),
        ("poses.txt", r"[^/]*poses\.txt"),
    ),
    "redwood": (
        ("trajectory.log", r"(?:scene/)?[^/]+\.log"),
        ("color", r"(?:color|image|rgb|images)/[^/]+\.(?:png|jpe?g)"),
    ),
    "sens": ((".sens", r"[^/]+\.sens"),),
    "rtabmap": ((".db", r"[^/]+\.db"),),
    "ros-bag": ((".bag, .db3 or .mcap", r"[^/]+\.(?:bag|(?:db3|mcap)(?:\.zstd?)?)"),),
}


@dataclass(frozen=True, slots=True)
class Recognised:
    """A format, the folder of its scan in the archive ("" for the top), and what a scan of it lacks."""

    format: str
    folder: str
    missing: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return it for JSON."""
        return {"format": self.format, "folder": self.folder, "missing": list(self.missing)}


def recognised(names: Iterable[str]) -> tuple[Recognised, ...]:
    """Return what paths with forward slashes look like: formats with nothing missing, else those that lack least.

    Of formats whose folders lie in each other the outermost is returned, as a build reads it.
    No file is opened, so files of other formats with such names may be taken for one.
    """
    paths = [name.replace("\\", "/").removeprefix("./") for name in names]
    found = [item for name, parts in PARTS.items() if (item := _match(name, parts, paths)) is not None]
    name = None if found else format_of_names(paths)
    if name is not None:
        listed = (path for path in paths if path.rpartition("/")[2] == LIST_NAME)
        return (Recognised(name, next(listed, paths[0]).rpartition("/")[0], ()),)
    least = min((len(item.missing) for item in found), default=0)
    best = [item for item in found if len(item.missing) == least]
    # The frames of a scan of 12-Scenes, in its folder data, are called as those of 7-Scenes.
    return tuple(item for item in best if not any(_is_inside(item.folder, other.folder) for other in best))


def _is_inside(folder: str, other: str) -> bool:
    return folder != other and (not other or folder.startswith(f"{other}/"))


def _match(name: str, parts: Sequence[Part], paths: Sequence[str]) -> Recognised | None:
    # The outermost folder: a model in sparse/0 belongs to the folder that its pictures are in.
    first = re.compile(rf"((?:.*?/)??){parts[0][1]}", re.IGNORECASE)
    folder = next((match.group(1) for path in paths if (match := first.fullmatch(path))), None)
    if folder is None:
        return None
    below = [path.removeprefix(folder) for path in paths if path.startswith(folder)]
    missing = (
        shown
        for shown, pattern in parts
        if not any(re.fullmatch(pattern, path, re.IGNORECASE) for path in below)
    )
    return Recognised(name, folder.rstrip("/"), tuple(missing))
