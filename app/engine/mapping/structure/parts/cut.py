"""A path cut where it is bent: where points made before and after a step disagree, or those of a picture don't fit."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.structure.matches import Pair, Rows
from app.engine.mapping.structure.parts.errors import errors_px
from app.engine.mapping.structure.parts.steps import Step, scale_steps
from app.engine.mapping.structure.reconstruction import OPTIONS as RECONSTRUCTION
from app.engine.mapping.structure.reconstruction import Reconstruction
from app.limits import limit
from app.vision.features import LocalFeatures


@dataclass(frozen=True, slots=True, kw_only=True)
class CutOptions:
    """When a step of a path is bent, and what ties the pieces of a path that was cut."""

    min_points: int = limit(
        10,
        "Points with a depth on both sides that may say that a step is bent.",
        chosen="By hand: for a median.",
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
    """Return the pieces of a path that nothing contradicts, the largest first; the path itself where all agrees.

    `near` are the matches of pictures that follow each other, `ties` the pairs of pictures that see one place again and
    agree with the path: pieces with enough of them between lie rightly to each other, whatever is between.
    """
    rows = sorted(path.poses)
    errors = errors_px(path, features)
    most_px = OPTIONS.max_error_ratio * float(np.median(list(errors.values())))
    good = [row for row in rows if errors.get(row, np.inf) <= most_px]
    broken = set(bent_steps(scale_steps(path, features, near))) | (set(rows) - set(good))
    if not broken:
        return [path]
    piece_of = {row: sum(1 for cut in sorted(broken) if cut < row) for row in good}
    group_of = _grouped(piece_of, ties)
    groups: dict[int, list[int]] = {}
    for row in good:
        groups.setdefault(group_of[piece_of[row]], []).append(row)
    pieces = [only(path, own) for own in groups.values() if len(own) >= RECONSTRUCTION.min_frames]
    return sorted(pieces, key=lambda piece: -len(piece.poses))


def bent_steps(steps: Mapping[int, Step]) -> list[int]:
    """Return the pictures after which the scale changes, by the steps after each picture."""
    rows = sorted(steps)
    ratios = np.array([steps[row].log_ratio if steps[row].points else 0.0 for row in rows])
    beside = np.concatenate([ratios[:1], ratios, ratios[-1:]])
    middle: NDArray[np.float64] = np.median(np.stack([beside[:-2], beside[1:-1], beside[2:]]), axis=0)
    return [
        row
        for row, ratio in zip(rows, middle, strict=True)
        if steps[row].points >= OPTIONS.min_points
        and abs(ratio) > max(float(np.log(OPTIONS.max_scale_ratio)), OPTIONS.sigmas * steps[row].sigma)
    ]


def only(part: Reconstruction, rows: Iterable[int]) -> Reconstruction:
    """Return some pictures of a part, with the part's points."""
    kept = sorted(rows)
    seen = part.observations[np.isin(part.observations[:, 0], kept)]
    return replace(part, poses={row: part.poses[row] for row in kept}, observations=seen)


def _grouped(piece_of: Mapping[int, int], ties: Collection[Pair]) -> dict[int, int]:
    """Return the group of each piece: pieces with enough ties between them are of one."""
    counts = Counter(
        (piece_of[i], piece_of[j])
        for i, j in ties
        if i in piece_of and j in piece_of and piece_of[i] != piece_of[j]
    )
    group_of = {piece: piece for piece in set(piece_of.values())}
    for (a, b), count in sorted(counts.items()):
        if count >= OPTIONS.min_ties:
            old, new = group_of[b], group_of[a]
            group_of = {piece: new if group == old else group for piece, group in group_of.items()}
    return group_of
