"""A building of two floors, rendered by the project itself: scans, phone pictures and plans to try it with.

Rendering needs the `bench` extra (embreex) and raises `MissingRendererError` without it; venue and plans don't.
"""

from __future__ import annotations

from bench.recordings.queries import PHONE_CAMERA, REGIONS, DemoQuery, floor_of, render_queries
from bench.recordings.scan import SCAN_CAMERA, VENUE_FRAMES, WING_FRAMES, DemoScan, render_venue, render_wing
from bench.render.raycast import render
from bench.render.scene import MissingRendererError, Scene, demo_scene
from bench.venue.layout import CORRIDORS, WING_ROOMS
from bench.venue.venue import VENUE, DemoFloor, DemoVenue, floor_plans, write_floor_plans

__all__ = [
    "CORRIDORS",
    "PHONE_CAMERA",
    "REGIONS",
    "SCAN_CAMERA",
    "VENUE",
    "VENUE_FRAMES",
    "WING_FRAMES",
    "WING_ROOMS",
    "DemoFloor",
    "DemoQuery",
    "DemoScan",
    "DemoVenue",
    "MissingRendererError",
    "Scene",
    "demo_scene",
    "floor_of",
    "floor_plans",
    "render",
    "render_queries",
    "render_venue",
    "render_wing",
    "write_floor_plans",
]
