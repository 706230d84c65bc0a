"""The path of a video or recording: first from pictures beside each other, then its parts are joined, and tied where it
comes back to a place."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from app.engine.mapping.structure.joined import rejoined
from app.engine.mapping.structure.matches import MatchedPictures, Pair, Rows
from app.engine.mapping.structure.parts.between import with_pieces_between
from app.engine.mapping.structure.parts.cut import cut_where_bent, cut_where_wrong
from app.engine.mapping.structure.parts.join import join_parts
from app.engine.mapping.structure.parts.placed import with_placed
from app.engine.mapping.structure.reconstruction import Reconstruction, median_depth
from app.engine.mapping.structure.revisits import OPTIONS as REVISITS
from app.engine.mapping.structure.revisits import Revisits, find_revisits
from app.engine.mapping.structure.up import DownDirection
from app.engine.mapping.structure.windows.reconstruct import reconstruct_windows
from app.engine.progress import Progress
from app.errors import DegenerateGeometryError
from app.geometry.alignment import align_points
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.limits import limit

NAMED_GAPS = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class SequenceOptions:
    """How the parts of a path grow together."""

    rounds: int = limit(
        5,
        "Times that parts are joined, pictures between them registered, and both adjusted.",
        chosen="By hand: a round takes minutes of a video of four; it ends earlier where no part is added.",
    )
    settled_depth_ratio: float = limit(
        0.005,
        "They end where no picture is added to the path and they moved by less, in the median, over the median depth.",
        chosen="By hand: 2 cm, less than such a path is off by.",
    )
    ends: int = limit(
        6,
        "Pictures at each end of a part that are registered by the points of the part beside it.",
        chosen="By hand: twice as many as must agree on how the part lies.",
    )


OPTIONS = SequenceOptions()


@dataclass(frozen=True, slots=True)
class Path3D:
    """The connected parts, the largest first, and what tied its path where it comes back to a place, None without.

    `joined` is the number of parts of which the largest was made.
    """

    parts: list[Reconstruction]
    revisits: Revisits | None
    joined: int = 1

    def where_it_broke(self, times_s: Sequence[float]) -> str:
        """Return a sentence on the stretches that the largest part leaves out; `times_s` are those of all pictures."""
        known = sorted(self.parts[0].poses)
        gaps = [
            (times_s[i + 1], times_s[j - 1]) for i, j in pairwise([-1, *known, len(times_s)]) if j > i + 1
        ]
        longest = sorted(sorted(gaps, key=lambda gap: gap[0] - gap[1])[:NAMED_GAPS])
        stretches = ", ".join(f"{start:.0f} to {end:.0f} s" for start, end in longest)
        several = f"The path fell into {len(self.parts)} parts; the largest"
        return (
            f"{several if len(self.parts) > 1 else 'The path'} holds {len(known)} of {len(times_s)} chosen "
            f"pictures and leaves out {stretches}. Film more slowly at doors and turns, step aside instead of turning "
            "on the spot, and keep things with texture in view."
        )


def reconstruct_sequence(
    matched: MatchedPictures,
    camera: Camera,
    times_s: Sequence[float],
    down_of: Callable[[Reconstruction], DownDirection | None],
    *,
    is_calibrated: bool,
    scratch: Path | None,
    progress: Progress,
) -> Path3D:
    """Return the connected parts of pictures that follow each other, taken at `times_s`.

    Pictures that are far apart in time never decide the path by themselves, however well they match: two corridors that
    look alike match as one does with itself. They tie it where the path that was found without them leads back to the
    place, and join its parts where the pictures of one agree on how it lies in the other. `down_of` finds the direction
    of down in the frame of a part. The other arguments are those of `reconstruct`.
    """
    near, far = _by_distance_in_time(matched.matches)
    parts = reconstruct_windows(
        MatchedPictures(matched.features, near),
        camera,
        times_s,
        is_calibrated=is_calibrated,
        scratch=scratch,
        progress=progress,
    )
    if not parts or (not far and len(parts) == 1):
        return Path3D(parts, None)
    revisits, settled = None, None
    joined, is_settled = 1, False
    for _ in range(OPTIONS.rounds):
        if not parts:
            break
        (found, count), *others = join_parts(parts, matched, times_s, progress)
        if revisits is not None and (count == 1 or is_settled):
            break
        joined += count - 1
        rest = [part for part, _ in others]
        whole = with_placed(found, matched, times_s)
        revisits = find_revisits(whole, matched, sorted(far), progress)
        if revisits.agreeing or len(whole.poses) > len(parts[0].poses):
            down = down_of(whole)
            ties = {pair: far[pair] for pair in revisits.agreeing}
            tied = rejoined(
                MatchedPictures(matched.features, without_insides(near | ties, rest, revisits.poses)),
                revisits.poses,
                whole.camera,
                down=None if down is None else down.down,
                is_calibrated=is_calibrated,
                scratch=scratch,
                progress=progress,
            )
            whole = tied or whole
        is_settled, settled = _is_settled(settled, whole), whole
        parts = [*cut_where_wrong(whole, matched.features, near, times_s), *rest]
    if joined == 1 or not parts:
        return Path3D(sorted(parts, key=lambda part: -len(part.poses)), revisits)
    agreeing = revisits.agreeing if revisits is not None else ()
    parts, placed = _joined_at_last(parts, matched, near, agreeing, times_s, progress)
    return Path3D(parts, revisits, joined + placed)


def _joined_at_last(
    parts: Sequence[Reconstruction],
    matched: MatchedPictures,
    near: Mapping[Pair, Rows],
    ties: Collection[Pair],
    times_s: Sequence[float],
    progress: Progress,
) -> tuple[list[Reconstruction], int]:
    """Return the parts joined a last time, the largest cut to what is determined, and how many pieces lie between.

    What an adjustment bends again and again is left as it was joined.
    """
    (whole, _), *others = join_parts(parts, matched, times_s, progress)
    pieces = [
        piece
        for part in cut_where_wrong(whole, matched.features, near, times_s)
        for piece in cut_where_bent(part, matched.features, near, ties)
    ]
    return with_pieces_between([*pieces, *(part for part, _ in others)], matched, times_s)


def _is_settled(before: Reconstruction | None, after: Reconstruction) -> bool:
    """Return whether a path has the same pictures as before, nearly where they were, but for a similarity."""
    if before is None or before.poses.keys() != after.poses.keys():
        return False
    a, b = (np.array([part.poses[row].translation for row in sorted(part.poses)]) for part in (before, after))
    try:
        found = align_points(a, b, with_scale=True)
    except DegenerateGeometryError:
        return False
    moved = found.target_from_source.apply(found.scale * a)
    middle = float(np.median(np.linalg.norm(moved - b, axis=1)))
    return middle <= OPTIONS.settled_depth_ratio * median_depth(after)


def without_insides(
    matches: Mapping[Pair, Rows], parts: Sequence[Reconstruction], known: Mapping[int, Pose]
) -> dict[Pair, Rows]:
    """Return the matches without the pictures inside of other parts, whose poses are not `known`.

    Enough at both ends stay to tie a part: its own path is more exact than one that is found anew picture by picture.
    """
    inside = {row for part in parts for row in sorted(part.poses)[OPTIONS.ends : -OPTIONS.ends]}
    out = inside - known.keys()
    return {pair: rows for pair, rows in matches.items() if out.isdisjoint(pair)}


def _by_distance_in_time(matches: Mapping[Pair, Rows]) -> tuple[dict[Pair, Rows], dict[Pair, Rows]]:
    near = {(i, j): rows for (i, j), rows in matches.items() if j - i <= REVISITS.beside}
    return near, {pair: rows for pair, rows in matches.items() if pair not in near}
