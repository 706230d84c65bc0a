"""The pairs of monitoring camera and phone of each experiment, rendered in the demonstration building."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

from app.geometry.camera import Camera
from bench.anchors.demo_anchors import HD_PHONE, anchor_pair
from bench.anchors.pairs import AnchorPair
from bench.recordings.monitors import MonitorPair, render_again, render_monitor_pairs
from bench.render.daylight import AFTERNOON, EVENING, MORNING, Daylight
from bench.render.frames import Progress
from bench.render.scene import Building
from bench.venue.layout import ROOMS, Room, room_by_id
from bench.venue.places import PLACES

# The same phone with 1.5 times as many pixels each way.
FULL_HD_PHONE = Camera("PINHOLE", 1920, 1080, (1485.0, 1485.0, 961.0, 537.25))
# Half the width of a group of angles and of one of distances.
ANGLE_TOLERANCE_DEG = 3.0
DISTANCE_TOLERANCE_M = 0.5
ANGLES_DEG = (30.0, 45.0, 60.0)
DISTANCES_M = (5.0, 7.5, 10.0, 12.5)
# Where the other experiments put the phones.
ANY_ANGLE_DEG = (3.0, 45.0)
ANY_DISTANCE_M = (2.0, 10.0)
# Nothing else in the building is long and wide enough for 30 degrees at 12.5 m.
LONG_ROOMS = ("0-hall", "1-hall", "1-lecture")
LONG_FROM_M = 12.0
LIGHTS = (MORNING, AFTERNOON, EVENING)


class Experiment(StrEnum):
    """An experiment of the thesis's chapter 6 on pairs of pictures."""

    ANGLE = "angle"
    DISTANCE = "distance"
    RESOLUTION = "resolution"
    PLACE = "place"
    TIME_OF_DAY = "time-of-day"


@dataclass(frozen=True, slots=True)
class PairRenderer:
    """Renders `count` pairs for each row of an experiment, below one folder; what is there is not rendered again."""

    directory: Path
    count: int
    seed: int
    workers: int
    progress: Progress | None = None

    def groups(self, experiment: Experiment) -> dict[str, list[AnchorPair]]:
        """Return the pairs of an experiment by the names of its rows."""
        return {
            Experiment.ANGLE: self.angles,
            Experiment.DISTANCE: self.distances,
            Experiment.RESOLUTION: self.resolutions,
            Experiment.PLACE: self.places,
            Experiment.TIME_OF_DAY: self.times_of_day,
        }[experiment]()

    def angles(self) -> dict[str, list[AnchorPair]]:
        """Return pairs at 5 m by angle (C figure 6.4)."""
        return {f"{angle:g} deg": _anchors(self._fixed(angle, DISTANCES_M[0])) for angle in ANGLES_DEG}

    def distances(self) -> dict[str, list[AnchorPair]]:
        """Return pairs at 30 degrees by distance (C figure 6.5)."""
        return {f"{distance:g} m": _anchors(self._fixed(ANGLES_DEG[0], distance)) for distance in DISTANCES_M}

    def resolutions(self) -> dict[str, list[AnchorPair]]:
        """Return the same views by a phone of 720 and one of 1080 lines (C figure 6.6)."""
        pairs = self._anywhere("any", ROOMS)
        full = render_again(
            self._folder("any-1080"), pairs, seed=self.seed, workers=self.workers, phone_camera=FULL_HD_PHONE,
            progress=self.progress,
        )  # fmt: skip
        return {"1280 x 720": _anchors(pairs), "1920 x 1080": _anchors(full, FULL_HD_PHONE)}

    def places(self) -> dict[str, list[AnchorPair]]:
        """Return pairs by the kind of place (C figure 6.9)."""
        return {
            place: _anchors(self._anywhere(place, [room_by_id(room) for room in rooms]))
            for place, rooms in PLACES.items()
        }

    def times_of_day(self) -> dict[str, list[AnchorPair]]:
        """Return the same views by time of day, and the camera's in the morning with the phone's in the evening (C
        figure 6.11)."""
        pairs = self._anywhere("any", ROOMS)
        lit = {light.name: self._in_light(pairs, light) for light in LIGHTS}
        mixed = [
            replace(at_camera, phone=at_phone.phone)
            for at_camera, at_phone in zip(lit[MORNING.name], lit[EVENING.name], strict=True)
        ]
        rows = {name: _anchors(found) for name, found in lit.items()}
        return {**rows, f"camera {MORNING.name}, phone {EVENING.name}": _anchors(mixed)}

    def _in_light(self, pairs: Sequence[MonitorPair], light: Daylight) -> list[MonitorPair]:
        return render_again(
            self._folder(f"any-{light.name.replace(':', '')}"), pairs, seed=self.seed, workers=self.workers,
            phone_camera=HD_PHONE, building=Building(daylight=light), progress=self.progress,
        )  # fmt: skip

    def _fixed(self, angle_deg: float, distance_m: float) -> list[MonitorPair]:
        rooms = ROOMS if distance_m < LONG_FROM_M else [room_by_id(room) for room in LONG_ROOMS]
        return self._pairs(
            f"{angle_deg:g}-deg-{distance_m:g}-m",
            (angle_deg - ANGLE_TOLERANCE_DEG, angle_deg + ANGLE_TOLERANCE_DEG),
            (distance_m - DISTANCE_TOLERANCE_M, distance_m + DISTANCE_TOLERANCE_M),
            rooms,
        )

    def _anywhere(self, name: str, rooms: Sequence[Room]) -> list[MonitorPair]:
        return self._pairs(name, ANY_ANGLE_DEG, ANY_DISTANCE_M, rooms)

    def _pairs(
        self,
        name: str,
        angles_deg: tuple[float, float],
        distances_m: tuple[float, float],
        rooms: Sequence[Room],
    ) -> list[MonitorPair]:
        return render_monitor_pairs(
            self._folder(name), self.count, angles_deg, distances_m, seed=self.seed, workers=self.workers,
            phone_camera=HD_PHONE, progress=self.progress, rooms=rooms,
        )  # fmt: skip

    def _folder(self, name: str) -> Path:
        return self.directory / f"{name}-{self.count}-{self.seed}"


def _anchors(pairs: Sequence[MonitorPair], phone_camera: Camera = HD_PHONE) -> list[AnchorPair]:
    return [anchor_pair(pair, phone_camera) for pair in pairs]
