"""The path of a video or recording: first from pictures beside each other, then its parts are joined, and tied where it
comes back to a place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from app.engine.mapping.structure.joined import rejoined
from app.engine.mapping.structure.matches import MatchedPictures, Pair, Rows
from app.engine.mapping.structure.parts.join import join_parts
from app.engine.mapping.structure.parts.placed import with_placed
from app.engine.mapping.structure.reconstruction import Reconstruction, reconstruct
from app.engine.mapping.structure.revisits import OPTIONS as REVISITS
from app.engine.mapping.structure.revisits import Revisits, find_revisits
from app.engine.progress import Progress
from app.geometry.camera import Camera

NAMED_GAPS = 6


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
        return (
            f"The path fell into {len(self.parts)} parts; the largest holds {len(known)} of {len(times_s)} chosen "
            f"pictures and leaves out {stretches}. Film more slowly at doors and turns, and keep things with texture "
            "in view."
        )


def reconstruct_sequence(
    matched: MatchedPictures,
    camera: Camera,
    times_s: Sequence[float],
    *,
    is_calibrated: bool,
    scratch: Path | None,
    progress: Progress,
) -> Path3D:
    """Return the connected parts of pictures that follow each other, taken at `times_s`.

    Pictures that are far apart in time never decide the path by themselves, however well they match: two corridors that
    look alike match as one does with itself. They tie it where the path that was found without them leads back to the
    place, and join its parts where the pictures of one agree on how it lies in the other. The other arguments are those
    of `reconstruct`.
    """
    near, far = _by_distance_in_time(matched.matches)
    parts = reconstruct(
        MatchedPictures(matched.features, near),
        camera,
        is_calibrated=is_calibrated,
        scratch=scratch,
        progress=progress,
    )
    if not parts or not far:
        return Path3D(parts, None)
    (found, joined), *others = join_parts(parts, matched, times_s, progress)
    whole = with_placed(found, matched, times_s)
    revisits = find_revisits(whole, matched, sorted(far), progress)
    if revisits.agreeing or joined > 1 or len(whole.poses) > len(found.poses):
        ties = {pair: far[pair] for pair in revisits.agreeing}
        tied = rejoined(
            MatchedPictures(matched.features, near | ties),
            revisits.poses,
            whole.camera,
            is_calibrated=is_calibrated,
            scratch=scratch,
            progress=progress,
        )
        whole = tied or whole
    return Path3D([whole, *(part for part, _ in others)], revisits, joined)


def _by_distance_in_time(matches: Mapping[Pair, Rows]) -> tuple[dict[Pair, Rows], dict[Pair, Rows]]:
    near = {(i, j): rows for (i, j), rows in matches.items() if j - i <= REVISITS.beside}
    return near, {pair: rows for pair, rows in matches.items() if pair not in near}
