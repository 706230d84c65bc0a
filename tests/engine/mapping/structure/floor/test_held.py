"""An adjustment holds the floor on one level, unless that makes the camera rise or sink."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from app.engine.mapping.structure.floor import held
from app.engine.mapping.structure.floor.levels import find_floor
from app.engine.mapping.structure.joined import OPTIONS, rejoined
from app.engine.mapping.structure.matches import MatchedPictures
from app.engine.mapping.structure.reconstruction import Reconstruction
from app.engine.progress import NoProgress
from app.errors import CancelledBuildError
from tests.engine.mapping.structure.floor.corridor_walk import CAMERA, DOORS, DOWN, FRAMES, Corridor

pytest.importorskip("pycolmap")
SLIDE = 1.08
# So few points through a door leave the scale behind it open.
FEW = 4


def adjusted(corridor: Corridor, down: tuple[float, float, float] | None) -> Reconstruction:
    matched = corridor.matches()
    poses = {frame: corridor.slid_pose(frame, SLIDE) for frame in range(FRAMES)}
    part = rejoined(
        matched, poses, CAMERA, is_calibrated=True, scratch=None, progress=NoProgress(), down=down
    )
    assert part is not None
    assert len(part.poses) == FRAMES
    return part


def end_error_m(corridor: Corridor, part: Reconstruction) -> float:
    """Return how far the end of a path is off, with the first room as it is."""
    frames, (door, _) = range(FRAMES), DOORS
    own, true = (
        np.array([pose.translation for pose in poses])
        for poses in ([part.poses[row] for row in frames], [corridor.true_pose(row) for row in frames])
    )
    scale = np.linalg.norm(true[door - 1] - true[0]) / np.linalg.norm(own[door - 1] - own[0])
    turn = (corridor.true_pose(0) @ part.poses[0].inverse()).rotation
    return float(np.linalg.norm(scale * (own[-1] - own[0]) @ turn.T - (true[-1] - true[0])))


def test_a_path_that_bent_is_led_back_by_the_floor() -> None:
    corridor = Corridor(seen_through=FEW)
    free, on_floor = (adjusted(corridor, down) for down in (None, DOWN))
    assert end_error_m(corridor, free) > 0.5
    assert end_error_m(corridor, on_floor) < 0.6 * end_error_m(corridor, free)


def test_a_floor_with_steps_is_not_levelled() -> None:
    """Levelled by the scale, it would let the camera rise."""
    corridor = Corridor(seen_through=12, rise_m=0.15)
    free, on_floor = (adjusted(corridor, down) for down in (None, DOWN))
    assert corridor.slide_of(free) == pytest.approx(1.0, abs=0.01)
    assert {row: pose.matrix.tolist() for row, pose in on_floor.poses.items()} == {
        row: pose.matrix.tolist() for row, pose in free.poses.items()
    }


def test_where_no_floor_is_seen_nothing_is_held() -> None:
    walls = Corridor(floor_share=0.0)
    assert walls.slide_of(adjusted(walls, DOWN)) == walls.slide_of(adjusted(walls, None))


def test_a_short_path_is_left_as_it_is() -> None:
    """Two stretches of a floor can't bend against each other."""
    corridor, frames = Corridor(), 55
    whole = corridor.matches()
    matches = {pair: rows for pair, rows in whole.matches.items() if pair[1] < frames}
    matched = MatchedPictures(whole.features[:frames], matches)
    poses = {frame: corridor.slid_pose(frame, SLIDE) for frame in range(frames)}
    free, on_floor = (
        rejoined(matched, poses, CAMERA, is_calibrated=True, scratch=None, progress=NoProgress(), down=down)
        for down in (None, DOWN)
    )
    assert free is not None
    assert on_floor is not None
    floor = find_floor(free, DOWN)
    assert floor is not None
    assert len(floor.above) == OPTIONS.floor_stretches - 1
    np.testing.assert_array_equal(on_floor.points, free.points)


class _Stops(NoProgress):
    """Stops a build at its first report after an adjustment with a floor has begun."""

    def __init__(self) -> None:
        self.is_stopping = False

    def report(self, stage: str, done: int, total: int) -> None:
        del stage, done, total
        if self.is_stopping:
            raise CancelledBuildError("stopped")


def test_a_build_that_is_stopped_ends_an_adjustment_with_a_floor(monkeypatch: pytest.MonkeyPatch) -> None:
    stops = _Stops()
    begin = held._add_level

    def begun(*given: Any) -> tuple[int, int]:
        stops.is_stopping = True
        return begin(*given)

    monkeypatch.setattr(held, "_add_level", begun)
    corridor = Corridor(seen_through=FEW)
    poses = {frame: corridor.slid_pose(frame, SLIDE) for frame in range(FRAMES)}
    with pytest.raises(CancelledBuildError, match="stopped"):
        rejoined(
            corridor.matches(),
            poses,
            CAMERA,
            is_calibrated=True,
            scratch=None,
            progress=stops,
            down=DOWN,
        )
