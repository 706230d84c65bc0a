"""A piece of a path that nothing but time ties to the rest, placed by where the camera left it and where it came back.

Where a camera turns before a plain wall, no point carries the scale on. The piece after the turn has a shape but no
place. If the walk later comes back to known ground over a second such gap, both ends of the piece are known within the
step that the camera took meanwhile: two places far apart fix scale and direction, and the turns over the gaps the rest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.structure.matches import MatchedPictures
from app.engine.mapping.structure.parts.cut import only
from app.engine.mapping.structure.parts.join import Group, merged
from app.engine.mapping.structure.parts.localized import PartPoints
from app.engine.mapping.structure.parts.pace import usual_speed
from app.engine.mapping.structure.parts.similarity import Similarity
from app.engine.mapping.structure.reconstruction import Reconstruction
from app.engine.mapping.structure.revisits import OPTIONS as REVISITS
from app.engine.mapping.structure.windows.motions import motions_of
from app.geometry.alignment import average_poses
from app.geometry.camera import Camera
from app.geometry.se3 import Pose, attitude_difference_rad, position_difference_m, rotation_between
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class BetweenOptions:
    """Which pieces are placed by their ends."""

    max_gap_s: float = limit(
        2.0,
        "Longest time between the last picture before a gap and the first one after it.",
        chosen="By hand: a turn of a person, at whose ends pictures are often lost.",
    )
    min_length_ratio: float = limit(
        5.0,
        "Least distance between a piece's ends, relative to the way over both gaps at the usual speed.",
        chosen="By hand: the way is led on at the speed before and after, so that an end is off by a tenth of it.",
    )
    min_inliers: int = limit(
        15,
        "Matches of two pictures that agree with the turn over a gap.",
        chosen="As of a stretch's motions.",
    )
    max_turn_deg: float = limit(
        6.0,
        "Largest difference of a piece's attitude by the turns over its two gaps, and of its direction by its ends.",
        chosen="As of parts that are joined.",
    )
    end_pictures: int = limit(
        8,
        "Pictures at each end of a piece that are left out from a step on that is faster than those before it.",
        chosen="By hand: half of a turn.",
    )
    max_step_ratio: float = limit(
        1.75,
        "Largest speed of such a step, relative to the median of as many before it.",
        chosen="By hand: before a plain wall two steps of 1.9 and 2.1 m/s after those of 0.75 m/s were wrong.",
    )
    max_speed_ratio: float = limit(
        1.5,
        "Largest ratio of the usual speeds in the piece and elsewhere.",
        chosen="By hand: a person who films walks evenly; a scale that is off by more is found.",
    )


OPTIONS = BetweenOptions()


@dataclass(frozen=True, slots=True)
class _Gap:
    """Two pictures beside each other, one of the known path and one of the piece, and the way at the usual speed."""

    known: int
    own: int
    way: float


def with_pieces_between(
    parts: Sequence[Reconstruction], matched: MatchedPictures, times_s: Sequence[float]
) -> tuple[list[Reconstruction], int]:
    """Return the parts, the largest first, with those placed in it that begin and end beside it, and how many were.

    `times_s` are the times of all pictures.
    """
    if not parts:
        return [], 0
    whole, *rest = sorted(parts, key=lambda part: -len(part.poses))
    others, placed = list[Reconstruction](), 0
    for part in rest:
        piece = only(part, _steady(part, times_s))
        around = _without_inside(whole, piece)
        whole_from_piece = _placed(around, piece, matched, times_s)
        if whole_from_piece is None:
            others.append(part)
            continue
        both = [PartPoints.of(part, matched) for part in (around, piece)]
        whole = merged(Group({0: Similarity.identity(), 1: whole_from_piece}), both)
        placed += 1
    return [whole, *others], placed


def _steady(piece: Reconstruction, times_s: Sequence[float]) -> list[int]:
    """Return the pictures of a piece without those at its ends that lie beyond a step which is too fast."""
    rows = sorted(piece.poses)
    for _ in range(2):
        rows = rows[: _steady_count(rows, piece.poses, times_s)][::-1]
    return rows


def _steady_count(rows: Sequence[int], poses: Mapping[int, Pose], times_s: Sequence[float]) -> int:
    """Return how many pictures, in the order of time or against it, come before a step near the end that is too
    fast."""
    speeds = [
        position_difference_m(poses[i], poses[j]) / abs(times_s[j] - times_s[i]) for i, j in pairwise(rows)
    ]
    count = OPTIONS.end_pictures
    for step in range(max(count, len(speeds) - count), len(speeds)):
        if speeds[step] > OPTIONS.max_step_ratio * float(np.median(speeds[step - count : step])):
            return step + 1
    return len(rows)


def _without_inside(whole: Reconstruction, piece: Reconstruction) -> Reconstruction:
    """Return the path without the few pictures that it has of the piece's own time."""
    first, last = min(piece.poses), max(piece.poses)
    outside = [row for row in whole.poses if not first <= row <= last]
    inside = len(whole.poses) - len(outside)
    return only(whole, outside) if 0 < inside < len(piece.poses) / 2 and outside else whole


def _placed(
    whole: Reconstruction, piece: Reconstruction, matched: MatchedPictures, times_s: Sequence[float]
) -> Similarity | None:
    """Return how a piece lies in the path, None where its ends don't tell."""
    speed = usual_speed(whole.poses, times_s)
    gaps = _gaps(whole, piece, times_s, speed)
    if gaps is None:
        return None
    ends = np.array([_led_on(whole.poses, gap.known, gap.own, times_s) for gap in gaps])
    own = np.array([piece.poses[gap.own].translation for gap in gaps])
    length, own_length = (float(np.linalg.norm(each[1] - each[0])) for each in (ends, own))
    if own_length == 0 or length < OPTIONS.min_length_ratio * sum(gap.way for gap in gaps):
        return None
    scale = length / own_length
    first, last = (_turn_over(gap, whole, piece, matched) for gap in gaps)
    most = np.radians(OPTIONS.max_turn_deg)
    if first is None or last is None or attitude_difference_rad(first, last) > most:
        return None
    turn = average_poses([first, last]).rotation
    aligned = rotation_between(turn @ (own[1] - own[0]), ends[1] - ends[0])
    if attitude_difference_rad(Pose(aligned, np.zeros(3)), Pose.identity()) > most:
        return None
    rotation = aligned @ turn
    found = Similarity(Pose(rotation, ends.mean(axis=0) - scale * rotation @ own.mean(axis=0)), scale)
    ratio = scale * usual_speed(piece.poses, times_s) / speed if speed else np.inf
    return found if 1 / OPTIONS.max_speed_ratio <= ratio <= OPTIONS.max_speed_ratio else None


def _gaps(
    whole: Reconstruction, piece: Reconstruction, times_s: Sequence[float], speed: float
) -> tuple[_Gap, _Gap] | None:
    first, last = min(piece.poses), max(piece.poses)
    before = max((row for row in whole.poses if row < first), default=None)
    after = min((row for row in whole.poses if row > last), default=None)
    if before is None or after is None:
        return None
    gaps_s = times_s[first] - times_s[before], times_s[after] - times_s[last]
    if max(gaps_s) > OPTIONS.max_gap_s or not piece.poses.keys().isdisjoint(whole.poses):
        return None
    return _Gap(before, first, speed * gaps_s[0]), _Gap(after, last, speed * gaps_s[1])


def _led_on(poses: Mapping[int, Pose], known: int, wanted: int, times_s: Sequence[float]) -> Array:
    """Return where the camera is at a picture beside a known one, if it moves on as there."""
    step = 1 if known > wanted else -1
    before = poses.get(known + step)
    place = poses[known].translation
    if before is None:
        return place
    seconds = times_s[known] - times_s[known + step]
    return np.asarray(
        place + (place - before.translation) * (times_s[wanted] - times_s[known]) / seconds, np.float64
    )


def _turn_over(
    gap: _Gap, whole: Reconstruction, piece: Reconstruction, matched: MatchedPictures
) -> Pose | None:
    """Return the piece's attitude in the path by the turns between pictures on both sides of a gap."""
    lower, upper = sorted((gap.known, gap.own))
    near = range(REVISITS.beside)
    found: list[Pose] = []
    for i, j in ((lower - back, upper + on) for back in near for on in near):
        first, second = (whole, piece) if gap.known == lower else (piece, whole)
        if i not in first.poses or j not in second.poses or (i, j) not in matched.matches:
            continue
        j_from_i = _turn(i, j, matched, whole.camera)
        if j_from_i is None:
            continue
        # world_from_i @ i_from_j is the attitude of j in the frame of i.
        of_j = first.poses[i].rotation @ j_from_i.T
        turn = of_j @ second.poses[j].rotation.T
        found.append(Pose(turn if gap.known == lower else turn.T, np.zeros(3)))
    if not found:
        return None
    groups = [
        [each for each in found if attitude_difference_rad(own, each) <= np.radians(OPTIONS.max_turn_deg)]
        for own in found
    ]
    most = max(groups, key=len)
    return average_poses(most) if 2 * len(most) > len(found) else None


def _turn(i: int, j: int, matched: MatchedPictures, camera: Camera) -> Array | None:
    """Return the rotation from the camera of one picture to that of another, by their matches."""
    rows = matched.matches[i, j]
    a, b = matched.features[i].keypoints_px[rows[:, 0]], matched.features[j].keypoints_px[rows[:, 1]]
    motions = motions_of(a.astype(np.float64), b.astype(np.float64), camera, OPTIONS.min_inliers)
    return motions[0].b_from_a.rotation if motions else None
