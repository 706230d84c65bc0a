"""Monitoring cameras in the demonstration building: where they hang, and what an operator enters."""

from __future__ import annotations

import numpy as np
import pytest

from bench.render.scene import Scene
from bench.simulation.cameras import HANGS_M, MAX_POIS, HungCamera, hang_cameras, spec_of
from bench.venue.layout import room_at
from bench.venue.plan_image import plan_from_world


@pytest.fixture(scope="module")
def cameras(outline: Scene) -> list[HungCamera]:
    return hang_cameras(outline)


def test_cameras_hang_in_the_rooms_that_they_are_named_after(cameras: list[HungCamera]) -> None:
    assert 20 <= len(cameras) <= 60
    for camera in cameras:
        x, y, z = camera.world_from_camera.translation
        room = room_at(float(x), float(y), camera.floor)
        assert room is not None
        assert camera.name.startswith(f"{room.id}-")
        assert z == pytest.approx(room.base_m + HANGS_M)


def test_each_camera_has_pois_that_it_sees(cameras: list[HungCamera]) -> None:
    assert all(1 <= len(camera.pois) <= MAX_POIS for camera in cameras)
    assert np.median([len(camera.pois) for camera in cameras]) >= 2


def test_an_operators_tape_is_off_by_centimetres(cameras: list[HungCamera]) -> None:
    errors = []
    for camera in cameras:
        spec, plan = spec_of(camera), plan_from_world(camera.floor)
        at = plan.apply(camera.world_from_camera.translation)
        errors.append(np.hypot(spec.x - at[0], spec.y - at[1]))
        for poi, view in zip(spec.pois, camera.pois, strict=True):
            away_m = np.linalg.norm(plan.apply(view.in_world) - at)
            errors.append(abs(poi.distance_m - away_m))
    assert 0.005 < float(np.median(errors)) < 0.05
    assert max(errors) < 0.15
