"""The demonstration venue's monitoring cameras as anchors on its plans."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from app.engine.anchors.anchor import AnchorSpec, Poi
from app.geometry.camera import Camera
from app.geometry.camera_hint import hint_of
from app.geometry.se3 import Pose
from app.vision.images import Rgb, decode_image
from bench.anchors.maps import MapPair
from bench.anchors.pairs import AnchorPair
from bench.recordings.monitor_views import Floats, PrintView
from bench.recordings.monitors import MONITOR_CAMERA, MonitorPair
from bench.recordings.queries import PHONE_CAMERA
from bench.venue.plan_image import plan_from_world

# A phone that sends what its preview shows.
HD_PHONE = Camera("PINHOLE", 1280, 720, (990.0, 990.0, 640.5, 358.0))


def anchor_pair(pair: MonitorPair, phone_camera: Camera = PHONE_CAMERA) -> AnchorPair:
    """Return a rendered pair with its anchor as an administrator would enter it."""
    plan = plan_from_world(pair.floor)
    camera = plan.apply(pair.world_from_monitor.translation)
    phone = plan.apply(pair.world_from_phone.translation)
    pois = tuple(_poi(view, plan, camera) for view in pair.pois)
    spec = AnchorSpec(
        venue_id="demo",
        floor_id=str(pair.floor),
        x=float(camera[0]),
        y=float(camera[1]),
        height_m=float(camera[2]),
        heading_deg=None,
        camera=hint_of(MONITOR_CAMERA),
        pois=pois,
    )
    return AnchorPair(
        name=pair.name,
        spec=spec,
        monitor=_loader(pair.monitor),
        phone=_loader(pair.phone),
        monitor_camera=MONITOR_CAMERA,
        phone_camera=phone_camera,
        phone_on_plan=phone[:2],
        gravity_in_phone=pair.world_from_phone.rotation.T @ np.array([0.0, 0.0, -1.0]),
        angle_deg=pair.angle_deg,
        distance_m=pair.distance_m,
        seen=frozenset(pair.seen),
    )


def _poi(view: PrintView, plan: Pose, camera_on_plan: Floats) -> Poi:
    point = plan.apply(view.in_world)
    region = tuple((float(u), float(v)) for u, v in view.corners_px)
    return Poi(
        id=view.id,
        region_px=region,
        x=float(point[0]),
        y=float(point[1]),
        distance_m=float(np.linalg.norm(point - camera_on_plan)),
    )


def map_pair(pair: MonitorPair) -> MapPair:
    """Return a rendered pair as one in the venue's map."""
    return MapPair(anchor_pair(pair), pair.world_from_monitor, pair.pois[0].in_world)


def _loader(path: Path) -> Callable[[], Rgb]:
    return lambda: decode_image(path.read_bytes())
