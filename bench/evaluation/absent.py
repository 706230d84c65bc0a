"""Pictures of places that no map holds: none of them may be located."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from app.engine.progress import Progress
from app.errors import InvalidInputError
from app.geometry.camera import Camera
from app.vision.images import Rgb, decode_image
from bench.evaluation.outcome import outcome_of
from bench.evaluation.pipelines import FrameLocalizer
from bench.evaluation.pose_errors import QueryOutcome

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".webp")
SYNTHETIC = "synthetic"
# black, white, noise, plain walls
SYNTHETIC_COUNTS = {"black": 4, "white": 4, "noise": 8, "wall": 24}

Picture = tuple[str, Rgb]


@dataclass(frozen=True, slots=True)
class AbsentResult:
    """What the localizer made of places that are not in the map."""

    outcomes: tuple[QueryOutcome, ...]

    @property
    def located(self) -> tuple[QueryOutcome, ...]:
        """The false fixes."""
        return tuple(outcome for outcome in self.outcomes if outcome.located)

    @property
    def most_inliers(self) -> int:
        """The highest inlier count, located or not."""
        return max((outcome.inliers for outcome in self.outcomes), default=0)

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for JSON."""
        return {
            "images": len(self.outcomes),
            "located": len(self.located),
            "most_inliers": self.most_inliers,
            "outcomes": [outcome.as_dict() for outcome in self.outcomes],
        }


def locate_absent(
    localizer: FrameLocalizer, places: Sequence[str], camera: Camera, camera_given: bool, progress: Progress
) -> AbsentResult:
    """Locate pictures of places that are not in the map: `synthetic` ones, or those of folders.

    Each gets the field of view of `camera`, or no camera.
    """
    outcomes: list[QueryOutcome] = []
    for place in places:
        for name, rgb in pictures_of(place, camera.width, camera.height):
            progress.report("absent", len(outcomes), len(outcomes) + 1)
            started = time.perf_counter()
            found = localizer.localize(rgb, _fitted(camera, rgb) if camera_given else None)
            outcomes.append(outcome_of(name, found, None, 1e3 * (time.perf_counter() - started)))
    return AbsentResult(tuple(outcomes))


def check_places(places: Sequence[str]) -> None:
    """Raise `InvalidInputError` unless each is `synthetic` or a folder that holds images."""
    for place in places:
        if place != SYNTHETIC and not (Path(place).is_dir() and list_images(Path(place))):
            raise InvalidInputError(f"{place!r} is neither {SYNTHETIC} nor a folder with images.")


def pictures_of(place: str, width: int, height: int) -> Iterator[Picture]:
    """Yield names and pictures of `synthetic` places, of this size, or of a folder."""
    if place == SYNTHETIC:
        yield from synthetic_pictures(width, height)
    else:
        for path in list_images(Path(place)):
            yield path.name, decode_image(path.read_bytes())


def list_images(directory: Path) -> list[Path]:
    """Return the image files of a folder, by name."""
    return sorted(path for path in directory.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)


def synthetic_pictures(width: int, height: int) -> Iterator[Picture]:
    """Yield 40 pictures in which nothing can be recognised; always the same ones for a size.

    Black and white ones with a little more sensor noise each, noise of growing grain, and walls in one colour under
    soft light.
    """
    for kind, count in SYNTHETIC_COUNTS.items():
        for number in range(count):
            rng = np.random.default_rng([list(SYNTHETIC_COUNTS).index(kind), number])
            if kind == "noise":
                picture = _noise(width, height, number, rng)
            elif kind == "wall":
                picture = _wall(width, height, rng)
            else:
                level = 0.0 if kind == "black" else 255.0
                picture = level + rng.normal(0.0, 2.0 * number, (height, width, 3))
            yield f"{kind} {number + 1}", np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def _noise(width: int, height: int, number: int, rng: np.random.Generator) -> np.ndarray[Any, np.dtype[Any]]:
    grain = 2 ** (number // 2)
    coarse = rng.uniform(0, 255, (-(-height // grain), -(-width // grain), 3))
    return np.asarray(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC))


def _wall(width: int, height: int, rng: np.random.Generator) -> np.ndarray[Any, np.dtype[Any]]:
    light = cv2.resize(rng.uniform(0.75, 1.0, (3, 4)), (width, height), interpolation=cv2.INTER_CUBIC)
    paint = rng.uniform(60, 250, 3)
    return np.asarray(light[..., None] * paint + rng.normal(0.0, rng.uniform(0.5, 4.0), (height, width, 3)))


def _fitted(camera: Camera, rgb: Rgb) -> Camera:
    """Return the same field of view for an image of another size."""
    height, width = rgb.shape[:2]
    focal_px = camera.focal_px * max(width, height) / max(camera.width, camera.height)
    return Camera("PINHOLE", width, height, (focal_px, focal_px, (width - 1) / 2, (height - 1) / 2))
