"""The demonstration venue without any scan: floor plans and monitoring cameras with their frames (C chapter 3)."""

from __future__ import annotations

import json

import cv2
import numpy as np

from app.commands.build import ensure_venue
from app.engine.anchors.features import AnchorDescriber
from app.services.anchors import AnchorService
from app.services.floor_features import store_features
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.settings import Settings
from app.storage.floors import put_floor
from bench.recordings.monitors import MONITOR_CAMERA
from bench.render.noise import seeded
from bench.render.raycast import render
from bench.render.scene import Scene
from bench.render.sensor import ColourSensor, colour_picture
from bench.simulation.cameras import hang_cameras, spec_of
from bench.venue.venue import VENUE, DemoFloor, floor_plans

READY = "cameras.json"


def prepare_without_map(settings: Settings, scene: Scene, pois: int) -> int:
    """Fill a data folder with floors, landmarks and monitoring cameras, unless it has them; return how many cameras.

    There is no map in it, and nothing of the scan of the building is used.
    """
    ready = settings.data_dir / READY
    if ready.is_file():
        return int(json.loads(ready.read_text())["cameras"])
    resources = Resources.open(settings)
    try:
        ensure_venue(resources, VENUE.id, VENUE.name)
        for floor in floor_plans():
            _put_floor(resources, floor)
        for floor in floor_plans():
            store_features(resources, VENUE.id, floor.id, floor.features)
        service = AnchorService(resources, MapLibrary(resources), AnchorDescriber())
        cameras = hang_cameras(scene, pois)
        for camera in cameras:
            service.put(camera.name, spec_of(camera))
            rgb, _ = render(scene, MONITOR_CAMERA, camera.world_from_camera)
            service.push(camera.name, _jpeg(camera.name, rgb))
    finally:
        resources.close()
    ready.write_text(json.dumps({"cameras": len(cameras), "pois": sum(len(each.pois) for each in cameras)}))
    return len(cameras)


def _put_floor(resources: Resources, floor: DemoFloor) -> None:
    with resources.database.write() as connection:
        put_floor(
            connection,
            VENUE.id,
            floor.id,
            name=floor.name,
            level=floor.level,
            z_min_m=floor.z_min_m,
            z_max_m=floor.z_max_m,
            plan_from_world=floor.plan_from_world,
            plan_residual_m=None,
        )


def _jpeg(name: str, rgb: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]) -> bytes:
    sensor = ColourSensor(read_noise=2.0, shot_noise=0.2, vignetting=0.15)
    picture = colour_picture(seeded("monitor", name), rgb, MONITOR_CAMERA, sensor)
    return cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 92])[1].tobytes()
