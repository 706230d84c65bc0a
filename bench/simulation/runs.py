"""Trips of a simulation in several processes, each with the rendered building and a session service of its own."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from app.engine.anchors.features import AnchorDescriber
from app.engine.floors.floor import Floor
from app.engine.navigation.places import PlanPlace
from app.engine.tracking.settings import TrackerSettings
from app.errors import ConflictError, InvalidInputError
from app.geometry.plan import PlanTransform
from app.services.anchor_locator import AnchorLocator
from app.services.floor_features import FeatureLibrary
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.services.routes import RouteService
from app.services.sessions import SessionService
from app.settings import Settings
from app.storage.floors import list_floors
from bench.render.scene import loaded_scene
from bench.simulation.log import WalkLog
from bench.simulation.summary import Setting
from bench.simulation.trips import (
    Trip,
    candidates,
    pairs_by_length,
    place_on,
    shuffled,
    spots_of,
)
from bench.simulation.walks import SILENCE_S, Outcome, walk_trip
from bench.simulation.world import DemoBuilding, Phone, SessionNavigator, phone_camera
from bench.venue.venue import VENUE

# Rooms where no walk begins: those of two floors look alike.
NO_START = ("corridor", "stair", "lift", "restrooms")
NEVER = 1_000_000_000
# What `--relocation` means: the map always, only when odometry is lost, only for the first fix.
RELOCATION = {
    "on": TrackerSettings(),
    "lost": TrackerSettings(relocalize_every=NEVER, use_refresh=False),
    "off": TrackerSettings(use_relocation=False),
}
SHIFT_M = 0.8

Report = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class Job:
    """A trip under a setting; after `silence_s` without guidance its walker is lost."""

    setting: Setting
    trip: Trip
    seed: int
    silence_s: float = SILENCE_S

    def walk(self, width: int) -> dict[str, Any]:
        """Return what makes this the same walk when it is walked again."""
        trip = {"trip": self.trip.number, "start": self.trip.start, "to": self.trip.destination}
        silence = {} if self.silence_s == SILENCE_S else {"silence_s": self.silence_s}
        return {**asdict(self.setting), "seed": self.seed, "width": width, **trip, **silence}


@dataclass(slots=True)
class Place:
    """A data folder opened for simulations: floors by number, routes, and a service for each kind of relocation."""

    resources: Resources
    floors: dict[int, Floor]
    features: FeatureLibrary
    routes: RouteService
    services: dict[str, SessionService] = field(default_factory=dict)

    @staticmethod
    def open(settings: Settings, no_map: bool = False) -> Place:
        """Open a folder; raises `ConflictError` when it holds no mapped demonstration venue and needs one."""
        resources = Resources.open(settings)
        library, features = MapLibrary(resources), FeatureLibrary(resources.database)
        if not no_map and library.active(VENUE.id) is None:
            raise ConflictError("The demonstration venue has no map yet: run roomfix demo --whole first.")
        routes = RouteService(resources.database, features)
        with resources.database.read() as connection:
            floors = {floor.level: floor for floor in list_floors(connection, VENUE.id)}
        anchors = AnchorLocator(resources, AnchorDescriber(), features) if no_map else None
        services = {
            name: SessionService(resources, library, features, routes, anchors, tracking)
            for name, tracking in RELOCATION.items()
        }
        return Place(resources, floors, features, routes, services)


def choose_trips(
    place: Place, lengths: Sequence[float], runs: int, seed: int, from_floor: int | None = None
) -> list[Trip]:
    """Return a trip for each run: from a room that looks like no other, at most `SHIFT_M` off its landmark and facing
    anywhere, to any landmark by a route of the demanded length. With `from_floor` all begin on that floor."""
    marks = {
        mark.id: (floor.id, level, mark)
        for level, floor in place.floors.items()
        for mark in place.features.features(floor).landmarks.values()
    }
    starts = [
        name
        for name, (_, level, _) in marks.items()
        if from_floor in (None, level)
        and not name.startswith("door-")
        and not any(w in name for w in NO_START)
    ]
    if not starts:
        raise InvalidInputError(f"No walk can begin on floor {from_floor}: the building has no room there.")
    routes = {
        (start, end): place.routes.route(VENUE.id, f"{marks[start][0]}:{start}", f"{marks[end][0]}:{end}")
        for start, end in candidates(starts, list(marks))
    }
    building, trips = DemoBuilding(), []
    for number, (length_m, (start, end)) in enumerate(shuffled(pairs_by_length(routes, lengths), runs, seed)):
        rng = np.random.default_rng([seed, 4, number])
        _, level, mark = marks[start]
        floor = place.floors[level]
        back = PlanTransform(np.linalg.inv(np.asarray(floor.plan_from_world)))
        while True:
            shift = rng.uniform(-SHIFT_M, SHIFT_M, 2)
            x, y, _ = back.apply(np.array([mark.x + shift[0], mark.y + shift[1], 0.0]))
            if building.is_free(float(x), float(y), level):
                break
        goal = f"{marks[end][0]}:{end}"
        route = place.routes.route(VENUE.id, place_on(floor, float(x), float(y)), goal)
        trips.append(
            Trip(
                number=number,
                length_m=length_m,
                start=(float(x), float(y), level),
                heading_deg=float(rng.uniform(-180, 180)),
                destination=goal,
                route_m=route.distance_m,
                spots=spots_of(route),
                end=PlanPlace(marks[end][0], marks[end][2].x, marks[end][2].y),
            )
        )
    return trips


def run_jobs(
    settings: Settings,
    scene: Path,
    width: int,
    jobs: Sequence[Job],
    workers: int,
    report: Report,
    log: WalkLog,
) -> list[Outcome]:
    """Return what came of each job, in their order; those in the log are not walked again."""
    known = {number: log.get(job.walk(width)) for number, job in enumerate(jobs)}
    outcomes = {number: outcome for number, outcome in known.items() if outcome is not None}
    context = multiprocessing.get_context("spawn")
    no_map = any(job.setting.no_map for job in jobs)
    with ProcessPoolExecutor(workers, context, _start, (settings, scene, width, no_map)) as pool:
        left = [number for number in range(len(jobs)) if number not in outcomes]
        waiting = {pool.submit(_run, jobs[number]): number for number in left}
        for done in as_completed(waiting):
            number = waiting[done]
            outcomes[number] = done.result()
            log.add(jobs[number].walk(width), outcomes[number])
            report(len(outcomes), len(jobs))
    return [outcomes[number] for number in range(len(jobs))]


@dataclass(slots=True)
class _Worker:
    place: Place
    phone: Phone


_worker: list[_Worker] = []


def _start(settings: Settings, scene: Path, width: int, no_map: bool) -> None:
    cv2.setNumThreads(1)
    _worker.append(_Worker(Place.open(settings, no_map), Phone(loaded_scene(scene), phone_camera(width))))


def _run(job: Job) -> Outcome:
    worker = _worker[0]
    place, setting = worker.place, job.setting
    service = place.services[setting.relocation]
    navigator = SessionNavigator(service, VENUE.id, worker.phone, sends_gravity=setting.no_map)
    return walk_trip(
        job.trip,
        DemoBuilding(),
        place.floors,
        navigator,
        fps=setting.fps,
        light=setting.light,
        seed=job.seed,
        silence_s=job.silence_s,
    )
