"""Monitoring cameras in the demonstration building as an operator would hang them: one a room, one for each stretch of
corridor, aimed at its prints, of which two to four are measured by tape."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from app.engine.anchors.anchor import AnchorSpec, Poi
from app.geometry.camera_hint import hint_of
from app.geometry.se3 import Pose
from bench.recordings.monitor_views import PrintView, looking, visible_prints
from bench.recordings.monitors import MONITOR_CAMERA
from bench.render.noise import seeded
from bench.render.scene import Scene
from bench.render.surfaces import Box
from bench.venue.decor import wall_prints
from bench.venue.layout import ROOMS, Room
from bench.venue.plan_image import plan_from_world
from bench.venue.venue import VENUE

Floats = NDArray[np.float64]

# A longer room or corridor gets one camera for each stretch of at most this length.
STRETCH_M = 12.0
HANGS_M = 2.45
INSET_M = 0.3
AIM_M = 1.4
# Least width and height of a POI in the camera's picture.
MIN_POI_PX = 40.0
MAX_POIS = 4
# Standard deviation of what a tape says.
TAPE_SIGMA_M = 0.02
# The cameras' frames stay valid for the whole simulation.
MAX_AGE_S = 86400.0


@dataclass(frozen=True, slots=True)
class HungCamera:
    """A monitoring camera, its pose, and the prints that are its POIs."""

    name: str
    floor: int
    world_from_camera: Pose
    pois: tuple[PrintView, ...]


def hang_cameras(scene: Scene, most_pois: int = MAX_POIS) -> list[HungCamera]:
    """Return the cameras of the whole building; rooms without prints on their walls get none."""
    found = []
    for room in ROOMS:
        prints = wall_prints(room)
        for number, stretch in enumerate(_stretches(room)):
            best = _best_view(scene, room, stretch, prints)
            if best is not None:
                pose, views = best
                largest = sorted(views.values(), key=lambda view: -_side_px(view))[:most_pois]
                found.append(HungCamera(f"{room.id}-{number}", room.floor, pose, tuple(largest)))
    return found


def spec_of(camera: HungCamera) -> AnchorSpec:
    """Return the anchor as an operator would enter it, distances and places as a tape measures them."""
    rng = seeded("tape", camera.name)
    plan = plan_from_world(camera.floor)
    at = plan.apply(camera.world_from_camera.translation)
    place = at[:2] + rng.normal(0, TAPE_SIGMA_M, 2)
    pois = tuple(_poi(view, plan.apply(view.in_world), at, rng) for view in camera.pois)
    return AnchorSpec(
        venue_id=VENUE.id,
        floor_id=str(camera.floor),
        x=float(place[0]),
        y=float(place[1]),
        height_m=float(at[2]),
        heading_deg=None,
        camera=hint_of(MONITOR_CAMERA),
        pois=pois,
        max_age_s=MAX_AGE_S,
    )


def _poi(view: PrintView, point: Floats, camera: Floats, rng: np.random.Generator) -> Poi:
    x, y = point[:2] + rng.normal(0, TAPE_SIGMA_M, 2)
    return Poi(
        id=view.id,
        region_px=tuple((float(u), float(v)) for u, v in view.corners_px),
        x=float(x),
        y=float(y),
        distance_m=float(np.linalg.norm(point - camera) + rng.normal(0, TAPE_SIGMA_M)),
    )


def _stretches(room: Room) -> Iterator[tuple[float, float, float, float]]:
    """Yield the parts (x0, y0, x1, y1) of a room that get a camera each."""
    x0, y0, x1, y1 = room.interior
    along_x = x1 - x0 >= y1 - y0
    low, high = (x0, x1) if along_x else (y0, y1)
    edges = np.linspace(low, high, int(np.ceil((high - low) / STRETCH_M)) + 1)
    for start, end in pairwise(edges.tolist()):
        yield (start, y0, end, y1) if along_x else (x0, start, x1, end)


def _best_view(
    scene: Scene, room: Room, stretch: tuple[float, float, float, float], prints: Mapping[str, Box]
) -> tuple[Pose, dict[str, PrintView]] | None:
    """Return the pose under the ceiling from which most prints are seen, up to four, and these as large as can be."""
    x0, y0, x1, y1 = stretch
    places = [
        np.array([x0 + s * (x1 - x0), y0 + t * (y1 - y0), room.base_m + HANGS_M])
        for s, t in product((0.03, 0.5, 0.97), repeat=2)
        if (s, t) != (0.5, 0.5)
    ]
    aims = [
        np.array([x0 + s * (x1 - x0), y0 + t * (y1 - y0), room.base_m + AIM_M])
        for s, t in product((0.25, 0.5, 0.75), repeat=2)
    ]
    best: tuple[float, Pose, dict[str, PrintView]] | None = None
    for at, aim in product(places, aims):
        inside = np.clip(at[:2], [x0 + INSET_M, y0 + INSET_M], [x1 - INSET_M, y1 - INSET_M])
        eye = np.array([*inside, at[2]])
        if np.linalg.norm((aim - eye)[:2]) < 1.0:
            continue
        pose = looking(eye, aim)
        views = visible_prints(scene, MONITOR_CAMERA, pose, prints, MIN_POI_PX)
        score = min(len(views), MAX_POIS) + 1e-4 * sum(_side_px(view) for view in views.values())
        if views and (best is None or score > best[0]):
            best = score, pose, views
    return None if best is None else (best[1], best[2])


def _side_px(view: PrintView) -> float:
    corners = view.corners_px
    return float(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).min())
