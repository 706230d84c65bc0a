"""The order and the times of the frames of a phone that comes back."""

from __future__ import annotations

from pathlib import Path

from app.geometry.se3 import Pose
from app.importers.frames import Frame
from bench.tracking.sequences import there_and_back

FRAMES = [
    Frame(
        name=str(k),
        timestamp_s=10.0 + 0.1 * k,
        color=Path(f"{k}.png"),
        depth=Path(f"{k}.depth.png"),
        scan_from_camera=Pose.identity(),
    )
    for k in range(6)
]


def names_of(times: int) -> list[str]:
    return [frame.name for frame, _ in there_and_back(FRAMES, times)]


def test_the_way_back_has_other_pictures() -> None:
    assert names_of(0) == ["0", "1", "2", "3", "4", "5"]
    assert names_of(1) == ["0", "2", "4", "5", "3", "1"]
    assert names_of(2) == 2 * names_of(1)


def test_time_goes_on_at_the_pace_of_the_frames() -> None:
    times_s = [time_s for _, time_s in there_and_back(FRAMES, 1)]
    assert [round(time_s, 6) for time_s in times_s] == [10.0, 10.2, 10.4, 10.5, 10.7, 10.9]
    assert [time_s for _, time_s in there_and_back(FRAMES, 0)] == [frame.timestamp_s for frame in FRAMES]
