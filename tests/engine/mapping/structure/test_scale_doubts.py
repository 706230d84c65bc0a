"""Without a floor the distance of what was filmed says whether a stated scale can be meant."""

from __future__ import annotations

import pytest

from app.engine.mapping.structure.scale import FoundScale, doubts_of
from app.errors import InvalidScanError

# The median depth of the features in the path's own unit.
DEPTH = 0.5


def scale(distance_m: float, source: str = "distance") -> FoundScale:
    return FoundScale(metres_per_unit=distance_m / DEPTH, source=source)


@pytest.mark.parametrize("distance_m", [0.3, 2.0, 29.9])
def test_rooms_and_halls_are_not_doubted(distance_m: float) -> None:
    assert doubts_of(scale(distance_m), None, DEPTH) == []


@pytest.mark.parametrize(("distance_m", "than"), [(0.2, "nearer than 0.2"), (78.0, "farther than 78")])
def test_unusual_distances_are_warned_of(distance_m: float, than: str) -> None:
    (said,) = doubts_of(scale(distance_m), None, DEPTH)
    assert said.startswith(f"By this scale half of what the pictures show is {than} m")


@pytest.mark.parametrize("distance_m", [0.02, 200.0])
def test_impossible_distances_are_refused(distance_m: float) -> None:
    with pytest.raises(InvalidScanError, match="check the numbers of scale, which are metres"):
        doubts_of(scale(distance_m), None, DEPTH)
    # What a sensor measured is doubted by its unit.
    assert doubts_of(scale(distance_m, "depth"), None, DEPTH) == []
