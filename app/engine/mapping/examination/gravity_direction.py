"""Whether gravity is contradicted by how the camera turned, or by the floor that depth shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.examination.outcome import Finding
from app.geometry.camera import Camera
from app.importers.conventions import PoseArrays
from app.importers.frames import Scan
from app.limits import limit

Array = NDArray[np.float64]
_BY_HAND = (
    "By hand, with 20 parts of RedKitchen, freiburg1_rpy, desk_rs and the demonstration in view, and gravity turned "
    "by 90 degrees; no other scans have tested it."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class GravityDirectionOptions:
    """When turns of the camera, or surfaces, contradict gravity."""

    known_axis: float = limit(
        0.3,
        "Difference of the two largest singular values of the mean rotation from which the axis of the camera's turns "
        "confirms gravity.",
        chosen=_BY_HAND + " Cameras that hardly turn, or about all axes, have up to 0.21.",
    )
    certain_axis: float = limit(
        0.5,
        "The same difference from which that axis contradicts gravity beyond doubt.",
        chosen=_BY_HAND + " A camera that goes round a room has 0.66 to 0.91.",
    )
    agreeing_cosine: float = limit(
        0.9,
        "Cosine between gravity and an axis or the floor's normal from which they agree.",
        chosen=_BY_HAND + " Right ones have 0.98 or more.",
    )
    other_cosine: float = limit(
        0.7, "Cosine below which an axis of turns is another direction.", chosen="By hand: 45 degrees."
    )
    frames: int = limit(
        12, "Frames whose depth is searched for a floor.", chosen="By hand: some tenths of a second."
    )
    columns: int = limit(
        80, "Pixels of a row of depth that are used.", chosen="By hand: noise is small between them."
    )
    edge_ratio: float = limit(
        0.15,
        "Depths that differ by more than this, as a ratio, are not one surface.",
        chosen="By hand: a steep surface stays below it.",
    )
    cone_cosine: float = limit(
        0.966, "Cosine within which normals are of one direction.", chosen="By hand: 15 degrees."
    )
    pitch_cosine: float = limit(
        0.707,
        "Cosine between the pictures' usual upward direction and the normal of a floor, at least.",
        chosen="By hand: a camera is seldom pitched by more than 45 degrees.",
    )
    tried_normals: int = limit(
        400, "Normals that are tried as the floor's.", chosen="By hand: many more than directions differ."
    )
    floor_share: float = limit(
        0.04,
        "Share of all surfaces that a floor, tables and seats have.",
        chosen=_BY_HAND + " 0.05 to 0.48 are seen.",
    )
    rival_ratio: float = limit(
        0.7,
        "Surfaces that face up by the given gravity contradict it when they are less than this ratio of the floor's.",
        chosen=_BY_HAND + " A wall that fills the view has more, and is taken for a floor.",
    )
    sideways_cosine: float = limit(
        0.7,
        "Cosine between gravity and the pictures' usual left or right, from which a phone may have been held upright "
        "while its pictures lie on their side.",
        chosen="By hand: 45 degrees.",
    )
    sideways_rival_ratio: float = limit(
        0.3,
        "As rival_ratio, for such gravity: a wall that one side of the pictures shows is taken for a floor.",
        chosen="By hand, with the same parts and their cameras turned by 90 degrees: a right one has 0.52, gravity "
        "whose axes are exchanged 0.12 or less.",
    )


OPTIONS = GravityDirectionOptions()


def judge_gravity_direction(
    scan: Scan, camera: Camera, poses: PoseArrays, gravity: tuple[float, float, float]
) -> list[Finding]:
    """Return what contradicts `gravity`, the direction of down in the frame of `poses`, which fit the pictures."""
    down = np.array(gravity) / np.linalg.norm(gravity)
    mean_down = poses.rotations[:, :, 1].mean(axis=0)
    gap, axis = _axis_of_turns(poses.rotations)
    if axis @ mean_down < 0:
        axis = -axis
    if gap >= OPTIONS.known_axis and abs(axis @ down) > OPTIONS.agreeing_cosine:
        return []
    # A camera that lies on its side may pitch about a level axis, which is not down in its pictures then.
    upright = axis @ mean_down > OPTIONS.other_cosine
    if gap >= OPTIONS.certain_axis and upright and abs(axis @ down) < OPTIONS.other_cosine:
        return [_by_turns(axis, down)]
    return _by_floor(scan, camera, poses, down, mean_down)


def _axis_of_turns(rotations: Array) -> tuple[float, Array]:
    """Return the axis, (3,), about which the cameras turn, and by how much it is clearer than another one.

    A direction that stays the same in the camera's axes keeps its length in the mean over all frames.
    """
    _, lengths, axes = np.linalg.svd(rotations.transpose(0, 2, 1).mean(axis=0))
    return float(lengths[0] - lengths[1]), axes[0]


def _rival_ratio(poses: PoseArrays, down: Array) -> float:
    """Return the ratio of surfaces that face up by gravity, over those of the floor, below which it is contradicted."""
    is_sideways = abs(poses.rotations[:, :, 0].mean(axis=0) @ down) > OPTIONS.sideways_cosine
    return OPTIONS.sideways_rival_ratio if is_sideways else OPTIONS.rival_ratio


def _by_floor(scan: Scan, camera: Camera, poses: PoseArrays, down: Array, mean_down: Array) -> list[Finding]:
    if not scan.has_depth:
        return []
    normals = _surface_normals(scan, camera, poses)
    floor = _floor_normal(normals, -mean_down / np.linalg.norm(mean_down))
    if floor is None or -floor @ down > OPTIONS.agreeing_cosine:
        return []
    of_floor, by_gravity = _share(normals, floor), _share(normals, -down)
    if of_floor < OPTIONS.floor_share or by_gravity > _rival_ratio(poses, down) * of_floor:
        return []
    right = _rounded(-floor)
    return [
        Finding(
            code="gravity_direction",
            severity="doubtful",
            sentence=f"Gravity is {_apart_deg(down, -floor):.0f} degrees from what floor, tables and seats show: they "
            f"are {100 * of_floor:.0f} % of what the scan sees, and what would be level by the given gravity is "
            f'{100 * by_gravity:.0f} %. Give "gravity": {right}, unless the pictures lie on their side.',
            options={"gravity": right},
            figures={"floor_share": round(of_floor, 3), "gravity_share": round(by_gravity, 3)},
        )
    ]


def _by_turns(axis: Array, down: Array) -> Finding:
    right = _rounded(axis)
    return Finding(
        code="gravity_direction",
        sentence=f"Gravity is {_apart_deg(down, axis):.0f} degrees from the axis about which the camera turned, which "
        f'is also what is down in its pictures; give "gravity": {right}.',
        options={"gravity": right},
        certain=True,
        figures={"axis_cosine": round(float(axis @ down), 3)},
    )


def _surface_normals(scan: Scan, camera: Camera, poses: PoseArrays) -> Array:
    """Return unit normals, (n, 3), in the frame of the poses, of surfaces that depth shows, towards the camera."""
    rows = np.unique(np.linspace(0, len(scan.frames) - 1, OPTIONS.frames).round().astype(int))
    return np.vstack(
        [_normals_of(scan.depth_m(scan.frames[row]), camera) @ poses.rotations[row].T for row in rows]
    )


def _normals_of(depth_m: NDArray[np.float32], camera: Camera) -> Array:
    height, width = depth_m.shape
    step = max(width // OPTIONS.columns, 1)
    v, u = np.mgrid[0:height:step, 0:width:step]
    # Depth may have another size than its picture.
    pixels = np.column_stack((u.ravel() * camera.width / width, v.ravel() * camera.height / height))
    z = depth_m[::step, ::step].astype(np.float64)
    rays = camera.normalize(pixels).reshape(*z.shape, 2)
    points = np.dstack((rays * z[..., None], z))
    vertical = points[2:, 1:-1] - points[:-2, 1:-1]
    horizontal = points[1:-1, 2:] - points[1:-1, :-2]
    middle = points[1:-1, 1:-1]
    ends = np.stack((z[2:, 1:-1], z[:-2, 1:-1], z[1:-1, 2:], z[1:-1, :-2], middle[..., 2]))
    steps = np.maximum(np.abs(vertical[..., 2]), np.abs(horizontal[..., 2]))
    normals = np.cross(vertical, horizontal)
    lengths = np.linalg.norm(normals, axis=2)
    known = (ends > 0).all(axis=0) & (steps < OPTIONS.edge_ratio * middle[..., 2]) & (lengths > 0)
    unit = normals[known] / lengths[known][:, None]
    away = np.sum(unit * middle[known], axis=1) > 0
    return np.asarray(np.where(away[:, None], -unit, unit), dtype=np.float64)


def _floor_normal(normals: Array, up: Array) -> Array | None:
    """Return the normal that most surfaces have, (3,), of those that face up in the pictures; None without any."""
    facing = normals[normals @ up > OPTIONS.pitch_cosine]
    if not len(facing):
        return None
    tried = facing[:: max(len(facing) // OPTIONS.tried_normals, 1)]
    best = tried[np.argmax(np.count_nonzero(facing @ tried.T > OPTIONS.cone_cosine, axis=0))]
    mean: Array = facing[facing @ best > OPTIONS.cone_cosine].mean(axis=0)
    return mean / float(np.linalg.norm(mean))


def _share(normals: Array, direction: Array) -> float:
    return float(np.mean(normals @ direction > OPTIONS.cone_cosine))


def _apart_deg(a: Array, b: Array) -> float:
    return float(np.degrees(np.arccos(np.clip(a @ b, -1.0, 1.0))))


def _rounded(direction: Array) -> list[float]:
    return [round(value, 3) + 0.0 for value in direction.tolist()]
