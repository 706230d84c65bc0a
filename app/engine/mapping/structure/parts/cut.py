"""A path cut where it may be bent: where no points carry the scale over a step, where those made before and after it
disagree, and at pictures whose points don't fit."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.structure.matches import Pair, Rows
from app.engine.mapping.structure.parts.errors import errors_px
from app.engine.mapping.structure.parts.pace import leaps
from app.engine.mapping.structure.parts.steps import OPTIONS as STEPS
from app.engine.mapping.structure.parts.steps import Step, scale_steps
from app.engine.mapping.structure.reconstruction import OPTIONS as RECONSTRUCTION
from app.engine.mapping.structure.reconstruction import Reconstruction, median_depth
from app.limits import limit
from app.vision.features import LocalFeatures


@dataclass(frozen=True, slots=True, kw_only=True)
class CutOptions:
    """When a step of a path is bent, and what ties the pieces of a path that was cut."""

    min_points: int = limit(
        8,
        "Points with a depth on both sides that must carry the scale over a step.",
        chosen="By hand, on the video of `roomfix evaluate-video`: where the camera turns within centimetres at the "
        "end of a corridor there are 0 to 3, and the scale slid by a factor of 20; else 11 and more.",
    )
    max_sigma: float = limit(
        0.06,
        "Largest standard deviation of the logarithm of the scale over a step.",
        chosen="By hand: of several such steps in a row each may slide by as much.",
    )
    end_pictures: int = limit(
        2,
        "Pictures at an end of a path that need no points of their own.",
        chosen="A point's depth needs two pictures.",
    )
    max_scale_ratio: float = limit(
        1.1,
        "Largest ratio of the scales before and after a step, by the median of three steps.",
        chosen="By hand, on 85 pictures of the video of `roomfix evaluate-video`: on the right path at most 1.04, on "
        "one that is bent 1.07 to 1.12.",
    )
    sigmas: float = limit(
        3.0,
        "The same in standard deviations of the logarithm, at least.",
        chosen="By hand: else it is noise.",
    )
    max_error_ratio: float = limit(
        2.5,
        "Largest mean error of a picture's points, relative to the median of all pictures.",
        chosen="By hand, on the same pictures: beside a wrong turn it is 3 to 4 times as large; faint features of "
        "plain walls are up to twice as far off.",
    )
    sure_points: int = limit(
        50,
        "Points that must disagree on the scale over a step, for the path to be wrong there whatever ties it.",
        chosen="By hand, on both videos of `roomfix evaluate-video`: 129 and 221 do where a path was bent by 20 cm; 9 "
        "and 31 do at the end of a corridor where it was right.",
    )
    max_gap_s: float = limit(
        2.0,
        "Time between two pictures of a path that is wrong somewhere, from which on it is cut there too.",
        chosen="By hand: in less nobody leaves what is in view.",
    )
    min_ties: int = limit(
        3, "Pairs of pictures that see one place again and tie two pieces.", chosen="As many as join parts."
    )


OPTIONS = CutOptions()


def cut_where_bent(
    path: Reconstruction,
    features: Sequence[LocalFeatures],
    near: Mapping[Pair, Rows],
    ties: Collection[Pair],
) -> list[Reconstruction]:
    """Return the pieces of a path whose shape is determined, the largest first; the path itself where that is all.

    `near` are the matches of pictures that follow each other, `ties` the pairs of pictures that see one place again and
    agree with the path: pieces with enough of them between lie rightly to each other, whatever is between.
    """
    errors = errors_px(path, features)
    most_px = OPTIONS.max_error_ratio * float(np.median(list(errors.values())))
    cuts = set(broken_steps(scale_steps(path, features, near)))
    wrong = {row for row in path.poses if errors.get(row, np.inf) > most_px}
    if not cuts and not wrong:
        return [path]
    return _pieces(path, _groups(_runs(sorted(path.poses), cuts, wrong), ties))


def cut_where_leaping(path: Reconstruction, times_s: Sequence[float]) -> list[Reconstruction]:
    """Return the pieces of a path between steps that no person makes in their time, the largest first; the path itself
    where that is all. `times_s` are the times of all pictures."""
    found = leaps(path.poses, times_s, median_depth(path))
    return _pieces(path, _runs(sorted(path.poses), found, ())) if found else [path]


def cut_where_wrong(
    path: Reconstruction,
    features: Sequence[LocalFeatures],
    near: Mapping[Pair, Rows],
    times_s: Sequence[float],
) -> list[Reconstruction]:
    """Return the pieces of a path that is cut where it can't be right: where no person moves that fast, and where many
    points made before and after a step disagree on the scale.

    A bundle adjustment doesn't mend that: it leaves out what contradicts it. No ties hold these pieces together, for
    they agree with a path that is wrong. `times_s` are the times of all pictures; the rest is as of `cut_where_bent`.
    """
    steps = scale_steps(path, features, near)
    rows = sorted(path.poses)
    wrong = {row for row in broken_steps(steps) if steps[row].points >= OPTIONS.sure_points}
    wrong |= set(leaps(path.poses, times_s, median_depth(path)))
    if not wrong:
        return [path]
    gaps = {i for i, j in pairwise(rows) if times_s[j] - times_s[i] > OPTIONS.max_gap_s}
    return _pieces(path, _runs(rows, wrong | gaps, ()))


def _pieces(path: Reconstruction, groups: Iterable[Sequence[int]]) -> list[Reconstruction]:
    """Return the groups of pictures that are large enough, the largest first."""
    pieces = [only(path, own) for own in groups if len(own) >= RECONSTRUCTION.min_frames]
    return sorted(pieces, key=lambda piece: -len(piece.poses))


def broken_steps(steps: Mapping[int, Step]) -> list[int]:
    """Return the pictures after which the scale is not carried on, or changes, by the steps after each picture.

    That it changes the median of three steps must say: one alone may be of a pattern that repeats itself.
    """
    rows = sorted(steps)
    ratios = np.array([steps[row].log_ratio if steps[row].points else 0.0 for row in rows])
    beside = np.concatenate([ratios[:1], ratios, ratios[-1:]])
    middle: NDArray[np.float64] = np.median(np.stack([beside[:-2], beside[1:-1], beside[2:]]), axis=0)
    most = float(np.log(OPTIONS.max_scale_ratio))
    found = []
    for row, ratio in zip(rows, middle, strict=True):
        step = steps[row]
        is_weak = step.points < OPTIONS.min_points or step.sigma > OPTIONS.max_sigma
        if is_weak or abs(ratio) > max(most, OPTIONS.sigmas * step.sigma):
            found.append(row)
    return found


def _runs(rows: Sequence[int], cuts: Collection[int], wrong: Collection[int]) -> list[list[int]]:
    """Return the pictures between cuts and wrong pictures, in order."""
    runs: list[list[int]] = [[]]
    for row in rows:
        if row in wrong:
            runs.append([])
            continue
        runs[-1].append(row)
        if row in cuts:
            runs.append([])
    return [run for run in runs if run]


def _groups(runs: Sequence[list[int]], ties: Collection[Pair]) -> list[list[int]]:
    """Return the pictures of runs that ties hold together, and those few between runs of one group or at an end."""
    long = [number for number, run in enumerate(runs) if len(run) >= RECONSTRUCTION.min_frames]
    run_of = {row: number for number in long for row in runs[number]}
    group_of = _tied(long, run_of, ties)
    groups: dict[int, list[int]] = {}
    # What follows a run that is left out is not known any more than that one.
    ends = {number for number, beside in ((0, 1), (len(runs) - 1, len(runs) - 2)) if beside in long}
    for number, run in enumerate(runs):
        before = [group_of[other] for other in long if other <= number][-1:]
        after = [group_of[other] for other in long if other >= number][:1]
        is_end = number in ends and len(run) <= OPTIONS.end_pictures
        if before == after or is_end:
            for group in (before or after)[:1]:
                groups.setdefault(group, []).extend(run)
    return list(groups.values())


def _tied(long: Sequence[int], run_of: Mapping[int, int], ties: Collection[Pair]) -> dict[int, int]:
    """Return the group of each run: runs with enough ties between them are of one."""
    counts = Counter(
        (run_of[i], run_of[j]) for i, j in ties if i in run_of and j in run_of and run_of[i] != run_of[j]
    )
    group_of = {number: number for number in long}
    for (a, b), count in sorted(counts.items()):
        if count >= OPTIONS.min_ties:
            old, new = group_of[b], group_of[a]
            group_of = {number: new if group == old else group for number, group in group_of.items()}
    return group_of


def only(part: Reconstruction, rows: Iterable[int]) -> Reconstruction:
    """Return some pictures of a part, with those of its points whose depth they see themselves.

    What other pictures have made may have the scale of another piece.
    """
    kept = sorted(rows)
    seen = part.observations[np.isin(part.observations[:, 0], kept)]
    seen = seen[np.lexsort((seen[:, 0], seen[:, 2]))]
    numbers, first, point = np.unique(seen[:, 2], return_index=True, return_inverse=True)
    centres = np.array([part.poses[row].translation for row in seen[:, 0]]).reshape(-1, 3)
    ahead = part.points[seen[:, 2]] - centres
    direction = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    widest = np.zeros(len(numbers))
    np.maximum.at(widest, point, np.linalg.norm(direction - direction[first][point], axis=1))
    is_known = widest >= np.radians(STEPS.min_angle_deg)
    new, own = np.cumsum(is_known) - 1, is_known[point]
    return replace(
        part,
        poses={row: part.poses[row] for row in kept},
        points=part.points[numbers[is_known]],
        observations=np.column_stack([seen[own, :2], new[point[own]]]),
    )
