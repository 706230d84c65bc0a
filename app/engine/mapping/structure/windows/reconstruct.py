"""The parts of a long video: stretches that overlap, each reconstructed by itself with a camera calibrated before.

A stretch is short enough that its scale can't slide far, and two that overlap are found independently of each other:
where they agree on the pictures of both, neither is bent.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from app.engine.mapping.structure.joined import rejoined
from app.engine.mapping.structure.matches import MatchedPictures, Pair, Rows
from app.engine.mapping.structure.parts.cut import cut_where_bent, cut_where_leaping
from app.engine.mapping.structure.reconstruction import Reconstruction, reconstruct
from app.engine.mapping.structure.windows.motions import Motion, motions_of
from app.engine.mapping.structure.windows.positions import positioned
from app.engine.mapping.structure.windows.voted import voted_motions
from app.engine.progress import Progress
from app.geometry.camera import Camera
from app.limits import limit
from app.vision.features import LocalFeatures

MEASURE_STAGE = "measure_motions"
STAGE = "reconstruct"
# Pairs between two reports: some seconds of work.
REPORT_EVERY_PAIRS = 16
NO_FEATURES = LocalFeatures(np.zeros((0, 2), np.float32), np.zeros((0, 128), np.uint8))


@dataclass(frozen=True, slots=True, kw_only=True)
class WindowOptions:
    """How long the stretches are, and which of their pictures are trusted."""

    pictures: int = limit(
        50,
        "Pictures of a stretch.",
        chosen="By hand, on 85 pictures of the video of `roomfix evaluate-video` with two doors and two turns: in one "
        "stretch the positions were wrong by up to 18 cm, in stretches of 50 by up to 3.",
    )
    stride: int = limit(
        30,
        "Pictures from the beginning of a stretch to that of the next.",
        chosen="By hand: twenty pictures of both tell whether they agree.",
    )
    calibrated_on: int = limit(
        80,
        "Pictures by which the camera of a long video is calibrated; a video with no more is reconstructed picture by "
        "picture.",
        chosen="By hand: half a minute of walking.",
    )
    min_inliers: int = limit(
        15, "Matches that agree with a motion.", chosen="By hand: as many as GLOMAP asks for."
    )
    adjustments: int = limit(
        2,
        "Times that points are made anew and adjusted.",
        chosen="By hand: what the first leads back by tens of percent, the second makes exact.",
    )


OPTIONS = WindowOptions()


@dataclass(frozen=True, slots=True)
class _Within:
    """Passes the reports of what is done for one stretch on as its place among all pictures."""

    inner: Progress
    done: int
    total: int

    def report(self, stage: str, done: int, total: int) -> None:
        """Report the stretch."""
        del stage, done, total
        self.inner.report(STAGE, self.done, self.total)


def reconstruct_windows(
    near: MatchedPictures,
    camera: Camera,
    times_s: Sequence[float],
    *,
    is_calibrated: bool,
    scratch: Path | None,
    progress: Progress,
) -> list[Reconstruction]:
    """Return the parts of pictures matched with those beside them, the largest first; parts may share pictures.

    `times_s` are the times of all pictures. The other arguments are those of `reconstruct`, which does the work for a
    short video, and which calibrates the camera on the stretch with the most matches.
    """
    total = len(near.features)
    if total > OPTIONS.calibrated_on and not is_calibrated:
        first = reconstruct(
            _best_stretch(near), camera, is_calibrated=False, scratch=scratch, progress=progress
        )
        if first and len(first[0].poses) >= OPTIONS.calibrated_on // 2:
            camera, is_calibrated = first[0].camera, True
    if total <= OPTIONS.calibrated_on or not is_calibrated:
        return reconstruct(near, camera, is_calibrated=is_calibrated, scratch=scratch, progress=progress)
    motions = voted_motions(_measured(near, camera, progress))
    parts = []
    for rows in _windows(total):
        own = {pair: motion for pair, motion in motions.items() if pair[0] in rows and pair[1] in rows}
        parts += _parts(_only(near, rows), own, camera, scratch, _Within(progress, rows.start, total))
    pieces = list[Reconstruction]()
    for part in parts:
        progress.report(STAGE, total, total)
        for piece in cut_where_leaping(part, times_s):
            pieces += cut_where_bent(piece, near.features, near.matches, ())
    return sorted(pieces, key=lambda part: -len(part.poses))


def _windows(total: int) -> Iterator[range]:
    for start in range(0, max(1, total - OPTIONS.pictures + OPTIONS.stride), OPTIONS.stride):
        yield range(start, min(total, start + OPTIONS.pictures))


def _best_stretch(near: MatchedPictures) -> MatchedPictures:
    """Return the matches of the stretch whose weakest step from one picture to the next has most of them."""
    steps = np.array([len(near.matches.get((i, i + 1), ())) for i in range(len(near.features) - 1)])
    inside = np.lib.stride_tricks.sliding_window_view(steps, OPTIONS.calibrated_on - 1)
    start = int(max(range(len(inside)), key=lambda row: (inside[row].min(), inside[row].sum())))
    return _only(near, range(start, start + OPTIONS.calibrated_on))


def _only(near: MatchedPictures, rows: range) -> MatchedPictures:
    """Return the matches of some pictures, and no features of the others."""
    features = tuple(own if row in rows else NO_FEATURES for row, own in enumerate(near.features))
    found = {pair: own for pair, own in near.matches.items() if pair[0] in rows and pair[1] in rows}
    return MatchedPictures(features, found)


def _measured(near: MatchedPictures, camera: Camera, progress: Progress) -> Mapping[Pair, list[Motion]]:
    found = {}
    for number, ((i, j), rows) in enumerate(near.matches.items()):
        if number % REPORT_EVERY_PAIRS == 0:
            progress.report(MEASURE_STAGE, number, len(near.matches))
        a, b = near.features[i].keypoints_px[rows[:, 0]], near.features[j].keypoints_px[rows[:, 1]]
        own = motions_of(a.astype(np.float64), b.astype(np.float64), camera, OPTIONS.min_inliers)
        if own:
            found[i, j] = own
    return found


def _parts(
    near: MatchedPictures,
    motions: Mapping[Pair, Motion],
    camera: Camera,
    scratch: Path | None,
    progress: Progress,
) -> list[Reconstruction]:
    matches: dict[Pair, Rows] = {pair: near.matches[pair][motion.inliers] for pair, motion in motions.items()}
    inliers = MatchedPictures(near.features, matches)
    progress.report(STAGE, 0, 1)
    found = []
    for part in positioned(near, motions, camera, scratch):
        adjusted: Reconstruction | None = part
        for _ in range(OPTIONS.adjustments):
            if adjusted is not None:
                adjusted = rejoined(
                    inliers, adjusted.poses, camera, is_calibrated=True, scratch=scratch, progress=progress
                )
        if adjusted is not None:
            found.append(adjusted)
    return found
