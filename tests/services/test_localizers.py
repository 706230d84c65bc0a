"""Limits of trusted poses that an operator sets for the whole server."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.geometry.camera_hint import hint_of
from app.services.locate_result import LocateRequest
from app.services.resources import Resources
from app.services.wiring import wire_services
from app.settings import Settings
from tests.scenes import CAMERA, View, encode
from tests.server import Server


@pytest.mark.parametrize(
    ("stated", "reason"),
    [
        ({}, None),
        ({"min_confidence": 1.0}, "too_few_inliers"),
        ({"max_position_sigma_m": 1e-6}, "too_few_inliers"),
    ],
)
def test_a_servers_limits_hold(
    museum: Server, queries: list[View], stated: dict[str, float], reason: str | None
) -> None:
    resources = Resources.open(Settings(data_dir=Path(museum.data_dir), **stated))
    try:
        request = LocateRequest(
            image=encode(queries[0].rgb[:, :, ::-1], ".png"), venue="museum", camera=hint_of(CAMERA)
        )
        assert wire_services(resources).locate.locate(request).reason == reason
    finally:
        resources.close()
