"""A scan of colour images and poses alone becomes a map that locates as one with depth does."""

from __future__ import annotations

from collections.abc import Sequence

from tests.scenes import CAMERA_TEXT, Room, View, encode, pose_at, scan_files, zipped
from tests.server import Server, pose_errors


def without_depth(views: Sequence[View]) -> bytes:
    files = scan_files(views)
    return zipped({name: data for name, data in files.items() if not name.startswith("depth")})


def test_pictures_are_located_in_a_map_without_depth(museum: Server) -> None:
    room = Room(3)
    views = [
        room.view(pose_at(1.2 + 0.1 * (i % 5), 0.7 + 0.12 * i, 1.4 + 0.05 * (i % 3), 3.0 * (i % 4) - 6))
        for i in range(10)
    ]
    museum.add_venue("annex-without-depth")
    build = museum.build(without_depth(views), "annex-without-depth")
    assert build["state"] == "succeeded", build
    report = build["report"]
    assert any("triangulated" in note for note in report["notes"])
    assert report["examination"]["verdict"] == "confirmed"
    for y, yaw_deg in ((1.0, 2.0), (1.5, -3.0)):
        asked = room.view(pose_at(1.45, y, 1.43, yaw_deg))
        answer = museum.locate(encode(asked.rgb, ".png"), venue="annex-without-depth", camera=CAMERA_TEXT)
        assert answer["located"], answer["reason"]
        position_m, attitude_deg = pose_errors(answer, asked.world_from_camera)
        assert position_m < 0.02
        assert attitude_deg < 0.5
