"""Single pairs of frames: their features, the matches between them and their similarity (B table 2)."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

from app.engine.mapping.select_keyframes import frame_contents
from app.engine.progress import Progress
from app.errors import InvalidInputError
from app.importers.frames import Scan
from app.vision.features import LocalFeatureExtractor
from app.vision.matching import match_unit_vectors, to_unit_vectors


@dataclass(frozen=True, slots=True)
class PairContent:
    """Two frames by their numbers, the features of each, their matches N(a, b), and S of B eq. 5."""

    first: int
    second: int
    first_features: int
    second_features: int
    matches: int

    @property
    def similarity(self) -> float:
        """S = 2 N(a, b) / (N_a + N_b)."""
        return 2.0 * self.matches / max(self.first_features + self.second_features, 1)


def parse_pair(text: str, frames: int) -> tuple[int, int]:
    """Return the two numbers of `first,second`; raises `InvalidInputError` for what are no two frames of so many."""
    try:
        first, second = (int(part) for part in text.split(","))
    except ValueError:
        raise InvalidInputError(f"{text!r} is not the numbers of two frames: first,second.") from None
    if not (0 <= first < frames and 0 <= second < frames):
        raise InvalidInputError(f"{text!r} names frames beyond 0 to {frames - 1}.")
    return first, second


def pair_contents(
    scan: Scan,
    pairs: Sequence[tuple[int, int]],
    extractor: LocalFeatureExtractor,
    executor: Executor,
    progress: Progress,
) -> list[PairContent]:
    """Return what the frames of each pair share."""
    numbers = sorted({number for pair in pairs for number in pair})
    few = replace(scan, frames=tuple(scan.frames[number] for number in numbers))
    poses = [frame.scan_from_camera for frame in few.frames]
    contents = frame_contents(few, poses, extractor, executor, progress)
    units = {
        number: to_unit_vectors(content.descriptors, extractor.binary)
        for number, content in zip(numbers, contents, strict=True)
    }
    found = []
    for first, second in pairs:
        a, b = units[first], units[second]
        rows, _, _ = match_unit_vectors(a, b, extractor.ratio, extractor.binary)
        found.append(PairContent(first, second, len(a), len(b), len(rows)))
    return found
