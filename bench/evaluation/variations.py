"""Variations: the ways in which the same queries are asked of the same map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from app.errors import InvalidInputError
from app.geometry.camera import Camera
from app.vision.images import Rgb
from bench.evaluation.degrade import DEGRADATIONS, Degraded, degrade


@dataclass(frozen=True, slots=True)
class Variation:
    """A degradation of every `every`-th query (the others stay as they are), with the camera given or not."""

    name: str
    degradation: str = "none"
    camera_given: bool = True
    every: int = 1

    def apply(self, number: int, name: str, rgb: Rgb, camera: Camera) -> Degraded:
        """Return query `number` of this name as it is asked."""
        degradation = self.degradation if number % self.every == self.every - 1 else "none"
        return degrade(degradation, rgb, camera, name)


PLAIN = Variation("none")
VARIATIONS = {
    **{name: Variation(name, name) for name in DEGRADATIONS},
    "no-camera": Variation("no-camera", camera_given=False),
    # Half of the queries have another field of view, so that no one focal length fits them all.
    "no-camera-mixed": Variation("no-camera-mixed", "narrow", camera_given=False, every=2),
}


def parse_variations(names: Sequence[str]) -> tuple[Variation, ...]:
    """Return the variations of these names, `all` for all of them; without names the plain one."""
    wanted = [each for name in names for each in (VARIATIONS if name == "all" else [name])]
    for name in wanted:
        if name not in VARIATIONS:
            raise InvalidInputError(f"Degradation {name!r} is not known; use all, {', '.join(VARIATIONS)}.")
    return tuple(VARIATIONS[name] for name in dict.fromkeys(wanted)) or (PLAIN,)
