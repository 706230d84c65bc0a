"""The walks of the scanner and of the phone: poses of a hand-held camera on ways through the rooms."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from app.geometry.se3 import Pose
from bench.render.noise import seeded
from bench.venue.layout import FLOOR_HEIGHT_M, STAIR_RISERS, STAIR_START_Y_M, STAIR_TREAD_M
from bench.venue.walkable import clearance_m, ground_z_m, sees, way

Floats = NDArray[np.float64]

STEP_M = 0.02
SCAN_HEIGHT_M = 1.45
# Distance between neighbouring frames of a camera that only moves.
METRES_PER_FRAME = 0.35
# Turn between neighbouring frames of a camera that only turns.
DEGREES_PER_FRAME = 14.0
# While walking, the scanner is swung to both sides.
SWEEP_DEG = 30.0
SWEEP_PERIOD_M = 8.0


@dataclass(frozen=True, slots=True)
class Stop:
    """A place on a walk; `turn_deg` is how far the person turns round there, looking about."""

    x: float
    y: float
    turn_deg: float = 0.0


@dataclass(frozen=True, slots=True)
class Walk:
    """Stops on one floor (`climb` 0), or the way up (1) or down (-1) the stair; the camera is held `arm_m` metres
    ahead of the body, round which it swings when the person turns."""

    floor: int
    stops: tuple[Stop, ...] = ()
    climb: int = 0
    arm_m: float = 0.12


def stops_of(text: str) -> tuple[Stop, ...]:
    """Return stops written as `x,y` or `x,y,turn`, separated by blanks."""
    return tuple(Stop(*(float(v) for v in part.split(","))) for part in text.split())


# Once round the main wing, looking about in each room; then back through part of it the other way.
WING_WALK: tuple[Walk, ...] = (
    Walk(
        0,
        stops_of(
            "2.0,3.0,300 3.3,6.5 3.0,10.0 3.4,12.8,200 5.6,15.6 7.2,16.4 7.0,19.4 5.0,22.2,300 8.0,23.2 "
            "12.0,23.0 14.6,23.8,150 18.6,22.6 18.6,19.4,90 14.2,18.6 14.2,15.4 15.6,12.6,160 18.8,11.6,180 "
            "14.6,9.4 14.5,6.8 13.6,5.2,330 11.2,6.0 9.0,4.4 6.2,4.8,180"
        ),
    ),
    Walk(0, stops_of("6.2,4.8 3.6,6.6 3.4,9.2 7.0,11.6 10.4,12.5 12.4,13.4,-120 14.0,16.6 14.4,19.6,-100")),
)
# The rest of the wing, walked against the first direction; only the scan of the whole venue has it.
WING_SECOND_WALK: tuple[Walk, ...] = (
    Walk(
        0,
        stops_of(
            "14.4,19.6 16.2,20.6,-160 12.4,23.4 8.6,22.4 8.8,19.0,-200 7.1,16.6 8.6,14.0 7.6,9.6,-150 "
            "3.4,8.4 3.8,1.8 8.2,2.6,-150 8.6,4.4 11.0,5.8 14.4,7.2 14.5,9.8 11.4,11.6 18.2,15.0,-150 "
            "12.0,13.2 9.4,12.4 5.4,15.4,-160 3.4,9.4 4.0,6.0"
        ),
    ),
)

# The east half, the same way on both floors except around the furniture of the north-west room.
_EAST = (
    "22.2,12.0 23.4,10.6,150 22.4,6.4 24.2,6.2 26.4,6.2 32.0,6.1,120 38.0,6.3 40.9,6.2,190 38.1,6.2 "
    "38.0,3.0,200 34.2,2.4 31.6,2.6 26.0,2.6 22.6,2.6,330 27.0,2.7 33.0,2.5 38.0,3.6 38.0,6.2 32.1,6.0 "
    "32.0,8.6 31.6,10.2,150 35.0,10.0 38.0,10.6,250 35.0,10.0 32.0,9.4 32.0,6.2 26.0,6.2 22.6,7.6 "
    "22.8,14.0,120 22.8,18.0 23.6,20.0 26.2,20.0 32.0,19.9,120 38.0,20.1 40.9,20.0,190 38.0,20.0 38.0,16.8 "
    "38.6,16.2,150 35.0,16.0 31.6,15.6,250 35.0,16.0 38.0,17.0 38.0,20.0 32.0,20.0 32.0,22.6 29.4,22.6,250 "
    "{north} 32.0,22.4 32.0,20.0 26.0,20.1 22.6,19.4,-120"
)
VENUE_WALK: tuple[Walk, ...] = (
    *WING_WALK,
    *WING_SECOND_WALK,
    Walk(
        0,
        stops_of(
            "4.0,6.0 3.0,9.4 6.0,12.0 10.0,12.5 13.0,12.6 19.4,10.0 19.0,7.0,160 18.6,4.0 19.0,9.2 20.4,12.0 "
            + _EAST.format(north="24.2,22.3,200 29.0,24.6 34.6,23.6 36.8,23.6 38.4,23.6,120 34.6,23.6")
        ),
    ),
    Walk(0, stops_of("22.8,12.0 22.8,8.6,90 24.4,8.3 26.5,8.3")),
    Walk(0, climb=1),
    Walk(
        1,
        stops_of(
            "26.5,15.8 24.2,15.8 23.2,15.6,150 22.4,12.0 "
            + _EAST.format(north="24.2,22.6,200 29.0,22.4 34.6,23.6 36.4,23.6 38.6,23.8,120 34.6,23.6")
        ),
    ),
    Walk(
        1,
        stops_of(
            "22.4,12.0 19.0,12.0 16.4,11.0,200 15.5,16.0 15.5,18.4 12.4,20.0,200 17.6,20.4 17.4,24.6,250 "
            "12.0,24.8 11.2,21.5 8.8,21.5 8.6,17.0,200 4.6,22.0,200 1.4,17.0 1.4,14.2 5.0,14.0 5.0,11.2,200 "
            "6.4,7.4 6.6,3.6,220 3.9,6.4 1.2,4.0,200 1.4,9.0 7.4,11.0 8.4,4.2 10.8,4.0 12.6,4.6,250 "
            "16.4,2.0,150 13.0,6.6 13.0,9.0 13.2,14.4,300 18.4,13.0 19.0,8.4 19.0,6.4,160 19.0,9.4 20.2,12.0 "
            "22.4,12.0,180"
        ),
    ),
)


def smooth_path(walk: Walk) -> tuple[Floats, Floats]:
    """Return points (n, 3), the ground under a walk every 2 cm, and for each how far to turn there, degrees
    (n,)."""
    if walk.climb:
        return _climb(walk.climb)
    stops = walk.stops
    legs = [way((a.x, a.y), (b.x, b.y), walk.floor) for a, b in pairwise(stops)]
    corners = np.concatenate([leg[:-1] for leg in legs] + [legs[-1][-1:]])
    xy = _loosened(_resampled(corners), walk.floor)
    turns = np.zeros(len(xy))
    for stop in stops:
        if stop.turn_deg:
            turns[np.argmin(np.hypot(*(xy - [stop.x, stop.y]).T) + 10.0 * (turns != 0))] = stop.turn_deg
    return np.column_stack([xy, [ground_z_m(x, y, walk.floor) for x, y in xy]]), turns


def _resampled(corners: Floats) -> Floats:
    lengths = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    at = np.arange(0, lengths[-1], STEP_M)
    return np.column_stack([np.interp(at, lengths, corners[:, k]) for k in range(corners.shape[1])])


def _loosened(xy: Floats, floor: int) -> Floats:
    """Round a way's corners as much as the free space allows."""
    for spread_m in (0.45, 0.3, 0.2, 0.1):
        smooth = gaussian_filter1d(xy, spread_m / STEP_M, axis=0, mode="nearest")
        if clearance_m(smooth[::5], floor).min() > 0.15:
            return np.asarray(smooth)
    return xy


def _climb(direction: int) -> tuple[Floats, Floats]:
    top = STAIR_START_Y_M + (STAIR_RISERS - 1) * STAIR_TREAD_M
    y = np.arange(8.3, 15.8, STEP_M)
    z = np.interp(y, [STAIR_START_Y_M - 0.1, top], [0, FLOOR_HEIGHT_M])
    points = np.column_stack([np.full(len(y), 26.5), y, gaussian_filter1d(z, 10)])
    return points[::direction], np.zeros(len(y))


def _headings(points: Floats, turns_deg: Floats, phase: float, arm_m: float) -> tuple[Floats, Floats]:
    """Return points (m, 3) and headings (m,) in radians, with the turns on the spot put in as extra
    samples."""
    ahead = gaussian_filter1d(np.gradient(points[:, :2], axis=0), 12, axis=0, mode="nearest")
    heading = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
    along = np.arange(len(points)) * STEP_M
    heading += np.radians(SWEEP_DEG) * np.sin(2 * np.pi * along / SWEEP_PERIOD_M + phase)
    places, angles = [], []
    turned = 0.0
    for point, angle, turn in zip(points, heading, turns_deg, strict=True):
        steps = int(abs(turn) / 2) + 1
        swing = np.radians(np.linspace(0, turn, steps)) if turn else np.zeros(1)
        # Turning on the spot moves the camera round the body, an arm's length.
        sway = arm_m * np.column_stack(
            [np.cos(angle + turned + swing), np.sin(angle + turned + swing), 0 * swing]
        )
        places.append(point + sway)
        angles.append(angle + turned + swing)
        turned += float(swing[-1])
    return np.concatenate(places), np.concatenate(angles)


def _evenly(points: Floats, headings: Floats, frames: int) -> tuple[Floats, Floats]:
    """Pick `frames` samples at equal steps of way and turn together."""
    moved = np.linalg.norm(np.diff(points, axis=0), axis=1) / METRES_PER_FRAME
    turned = np.abs(np.degrees(np.diff(headings))) / DEGREES_PER_FRAME
    progress = np.concatenate([[0], np.cumsum(np.hypot(moved, turned))])
    at = np.linspace(0, progress[-1], frames)
    return (
        np.column_stack([np.interp(at, progress, points[:, k]) for k in range(3)]),
        np.interp(at, progress, headings),
    )


def camera_pose(position: Floats, heading_rad: float, pitch_rad: float, roll_rad: float) -> Pose:
    """Return world_from_camera of a camera that looks along a heading; positive pitch looks up."""
    ch, sh, cp, sp = np.cos(heading_rad), np.sin(heading_rad), np.cos(pitch_rad), np.sin(pitch_rad)
    forward = np.array([ch * cp, sh * cp, sp])
    right, down = np.array([sh, -ch, 0.0]), np.array([ch * sp, sh * sp, -cp])
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    return Pose(np.column_stack([c * right + s * down, c * down - s * right, forward]), position)


def scan_poses(walks: tuple[Walk, ...], frames: int, seed: int = 0) -> list[Pose]:
    """Return world_from_camera for each frame of a scan along walks, with the unsteadiness of a hand."""
    places: list[Floats] = []
    headings: list[Floats] = []
    for k, walk in enumerate(walks):
        points, angles = _headings(*smooth_path(walk), phase=1.7 * k, arm_m=walk.arm_m)
        if headings:
            angles = angles + 2 * np.pi * np.round((headings[-1][-1] - angles[0]) / (2 * np.pi))
        places.append(points)
        headings.append(angles)
    smooth_heading = gaussian_filter1d(np.concatenate(headings), 8, mode="nearest")
    position, heading = _evenly(np.concatenate(places), smooth_heading, frames)
    rng = seeded("hand", seed, frames)
    wobble = gaussian_filter1d(rng.standard_normal((frames, 3)), 3, axis=0, mode="wrap") * 3.2
    position[:, 2] += SCAN_HEIGHT_M + 0.03 * wobble[:, 0]
    pitch, roll = np.radians(-4 + 4.0 * wobble[:, 1]), np.radians(1.8 * wobble[:, 2])
    return [camera_pose(*values) for values in zip(position, heading, pitch, roll, strict=True)]


def query_poses(scan: list[Pose], count: int, seed: int = 1) -> list[Pose]:
    """Return world_from_camera of phone pictures taken near a scan: up to 0.6 m and 30 degrees off its
    poses."""
    rng = seeded("phone", seed, count)
    found: list[Pose] = []
    while len(found) < count:
        base = scan[int(rng.integers(len(scan)))]
        pose = _near(rng, base)
        if pose is not None:
            found.append(pose)
    return found


def _near(rng: np.random.Generator, base: Pose) -> Pose | None:
    """Return a pose near another one, or None when it would stand too close to something or behind a wall."""
    x, y, z = base.translation
    floor = int(z > FLOOR_HEIGHT_M)
    angle, far = rng.uniform(0, 2 * np.pi), 0.6 * np.sqrt(rng.uniform())
    xy = np.array([x + far * np.cos(angle), y + far * np.sin(angle)])
    if clearance_m(xy[None], floor)[0] < 0.3 or not sees(base.translation[:2], xy, floor):
        return None
    forward = base.rotation[:, 2]
    heading = np.arctan2(forward[1], forward[0]) + np.radians(rng.uniform(-30, 30))
    height = floor * FLOOR_HEIGHT_M + rng.uniform(1.3, 1.7)
    pitch, roll = np.radians(rng.normal(-2, 4)), np.radians(rng.normal(0, 3))
    return camera_pose(np.array([*xy, height]), heading, pitch, roll)
