"""The demonstration venue's monitoring cameras as anchors on its plans."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from app.demonstration.monitors import MONITOR_CAMERA, REGION_HALF_PX, MonitorPair
from app.demonstration.plan_image import plan_from_world
from app.demonstration.queries import PHONE_CAMERA
from app.evaluation.anchor_maps import MapPair
from app.evaluation.anchors import AnchorPair
from app.geometry.camera import Camera
from app.geometry.plan import PlanTransform
from app.storage.anchors import AnchorSpec, Poi
from app.vision.images import Rgb, decode_image

# A phone that sends what its preview shows.
HD_PHONE = Camera("PINHOLE", 1280, 720, (990.0, 990.0, 640.5, 358.0))


def anchor_pair(pair: MonitorPair, phone_camera: Camera = PHONE_CAMERA) -> AnchorPair:
    """Return a rendered pair with its anchor as an administrator would enter it."""
    plan = plan_from_world(pair.floor)
    camera = plan.apply(pair.world_from_monitor.translation)
    point = plan.apply(np.array(pair.poi_in_world))
    phone = plan.apply(pair.world_from_phone.translation)
    (u, v), half = pair.poi_px, REGION_HALF_PX
    low = max(u - half, 0.0), max(v - half, 0.0)
    high = min(u + half, MONITOR_CAMERA.width - 1.0), min(v + half, MONITOR_CAMERA.height - 1.0)
    region = (low, (high[0], low[1]), high, (low[0], high[1]))
    distance_m = float(np.linalg.norm(point - camera))
    poi = Poi("poi", region, float(point[0]), float(point[1]), distance_m)
    spec = AnchorSpec(
        "demo",
        str(pair.floor),
        float(camera[0]),
        float(camera[1]),
        float(camera[2]),
        None,
        MONITOR_CAMERA,
        (poi,),
    )
    return AnchorPair(
        pair.name,
        spec,
        _loader(pair.monitor),
        _loader(pair.phone),
        MONITOR_CAMERA,
        phone_camera,
        phone[:2],
        pair.world_from_phone.rotation.T @ np.array([0.0, 0.0, -1.0]),
        pair.angle_deg,
        pair.distance_m,
    )


def map_pair(pair: MonitorPair) -> MapPair:
    """Return a rendered pair as one in the venue's map."""
    plan = PlanTransform(plan_from_world(pair.floor).matrix)
    return MapPair(anchor_pair(pair), pair.world_from_monitor, np.array(pair.poi_in_world), plan)


def _loader(path: Path) -> Callable[[], Rgb]:
    return lambda: decode_image(path.read_bytes())
