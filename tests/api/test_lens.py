"""A scan whose lens nobody stated, over HTTP: the report says what it showed, and queries are taken through it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from app.geometry.camera import Camera
from app.geometry.lens import Lens
from tests.scenes import CAMERA, CAMERA_TEXT, Room, query_poses, scan_files, walk, zipped
from tests.server import Server, pose_errors, running

COEFFICIENT = -0.1
BENT = Lens(COEFFICIENT).of(CAMERA)


@pytest.fixture(scope="module")
def bent(tmp_path_factory: pytest.TempPathFactory, room: Room) -> Iterator[Server]:
    """A server with a venue whose scan went through a lens that its options say nothing of."""
    with running(tmp_path_factory.mktemp("bent"), run_worker=False) as server:
        server.add_venue("bent")
        ended = server.add_map(zipped(scan_files([room.view(pose, BENT) for pose in walk()])), "bent")
        assert ended["report"]["lens"]["k1"] == pytest.approx(COEFFICIENT, abs=0.02)
        yield server


@pytest.mark.parametrize("method", ["rgbd", "vdm"])
def test_queries_by_the_camera_of_the_scan_are_taken_through_its_lens(
    bent: Server, room: Room, method: str
) -> None:
    errors_m = {"as given": [], "as without a lens": []}
    for pose in query_poses():
        photo = room.view(pose, BENT).jpeg()
        for how, camera in (("as given", CAMERA_TEXT), ("as without a lens", CAMERA_TEXT + ",0,0,0,0")):
            result = bent.locate(photo, venue="bent", method=method, camera=camera)
            assert result["located"], result
            errors_m[how].append(pose_errors(result, pose)[0])
    assert max(errors_m["as given"]) < 0.02
    assert sum(errors_m["as given"]) < 0.7 * sum(errors_m["as without a lens"])


def test_a_query_by_another_camera_has_its_lens_fitted(bent: Server, room: Room) -> None:
    # Not the focal length of the scan's camera, so its lens isn't known either.
    fx, fy, cx, cy = CAMERA.params
    longer = Lens(0.05).of(Camera("PINHOLE", 320, 240, (1.05 * fx, 1.05 * fy, cx, cy)))
    pose = query_poses()[1]
    text = ",".join(f"{value:g}" for value in longer.params[:4])
    result = bent.locate(room.view(pose, longer).jpeg(), venue="bent", camera=text)
    assert pose_errors(result, pose)[0] < 0.03


def test_a_camera_is_answered_as_it_was_given(bent: Server, room: Room) -> None:
    photo = room.view(query_poses()[0], BENT).jpeg()
    assert bent.locate(photo, venue="bent")["camera"]["params"] == pytest.approx(CAMERA.params)
    started = bent.client.post("/sessions", json={"venue": "bent", "camera": CAMERA_TEXT}).json()
    answer = bent.client.post(
        f"/sessions/{started['session']}/frames", files={"image": ("0.jpg", photo)}
    ).json()
    assert answer["located"], answer
    assert pose_errors(answer, query_poses()[0])[0] < 0.02
    assert answer["camera"]["params"] == pytest.approx(CAMERA.params)
    assert answer["camera"]["source"] == "request"
