"""A frame whose outcome can't be stored never was: the tracker goes back to what the database knows."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from sqlalchemy.exc import OperationalError

from app.geometry.camera_hint import hint_of
from app.services.resources import Resources
from app.services.session_answer import SessionResult
from app.services.sessions import SessionFrame, SessionService
from app.services.wiring import wire_services
from app.settings import Settings
from app.storage.maps import publish_map
from app.storage.venues import create_venue
from tests.rendered_maps import map_of_views
from tests.scenes import CAMERA, Room, View, pose_at

KEYFRAMES = [pose_at(1.8 + 0.05 * i, 1.5, 1.4, -30.0 + 15.0 * i) for i in range(10)]
HERE = pose_at(1.85, 1.45, 1.42, -20.0, 1.0)
# In the same room, but nobody turns and walks that far within a tenth of a second.
THERE = pose_at(3.3, 1.6, 1.42, 85.0, 1.0)


@dataclass
class Phone:
    """A session of a phone, on a server's service."""

    service: SessionService
    resources: Resources
    session: str

    def send(self, view: View, time_s: float) -> SessionResult:
        """Send a frame and return its answer."""
        return self.service.process(self.session, SessionFrame(view.png(), hint_of(CAMERA), time_s=time_s))

    @contextmanager
    def unable_to_store(self) -> Iterator[None]:
        """Let the database fail at each point of a trajectory within the block, after the session's row is written."""
        trigger = "CREATE TRIGGER broken BEFORE INSERT ON session_points BEGIN SELECT json('broken'); END"
        with self.resources.database.write() as connection:
            connection.exec_driver_sql(trigger)
        yield
        with self.resources.database.write() as connection:
            connection.exec_driver_sql("DROP TRIGGER broken")

    def fail(self, view: View, time_s: float) -> None:
        """Send a frame that can't be stored."""
        with self.unable_to_store(), pytest.raises(OperationalError, match="malformed JSON"):
            self.send(view, time_s)


@pytest.fixture
def phone(room: Room, tmp_path: Path) -> Iterator[Phone]:
    """A session in a venue whose map is the room."""
    resources = Resources.open(Settings(_env_file=None, data_dir=tmp_path, open=True))
    artifact, index = map_of_views([room.view(pose) for pose in KEYFRAMES])
    artifact.write(tmp_path / "map")
    index.write(tmp_path / "index")
    stored = [resources.blobs.put_file(tmp_path / name) for name in ("map", "index")]
    with resources.database.write() as connection:
        create_venue(connection, "v", "V")
        publish_map(connection, "v", "", *stored, {}, [])
    service = wire_services(resources).sessions
    yield Phone(service, resources, service.create("v").id)
    resources.close()


def test_the_frame_after_one_that_was_not_stored_is_followed_from_the_one_before(
    phone: Phone, room: Room
) -> None:
    here = room.view(HERE)
    first = phone.send(here, 0.0)
    assert (first.frame, first.tracking, first.result.method) == (1, "tracking", "rgbd")
    phone.fail(here, 0.1)
    second = phone.send(here, 0.2)
    # The points of the frame that was not stored are forgotten with it: the next one is located anew.
    assert (second.frame, second.tracking, second.result.method) == (2, "tracking", "rgbd")
    assert [point.time_s for point in second.trajectory] == [0.0, 0.2]
    assert phone.send(here, 0.3).result.method == "odometry"


def test_a_jump_is_not_confirmed_by_a_frame_that_was_not_stored(phone: Phone, room: Room) -> None:
    here, there = room.view(HERE), room.view(THERE)
    assert phone.send(here, 0.0).tracking == "tracking"
    phone.fail(there, 0.1)
    once = phone.send(there, 0.2)
    assert (once.tracking, once.result.reason) == ("lost", "ambiguous")
    twice = phone.send(there, 0.3)
    assert (twice.tracking, twice.result.reason) == ("relocalized", None)


def test_a_first_frame_that_was_not_stored_leaves_a_session_without_frames(phone: Phone, room: Room) -> None:
    phone.fail(room.view(HERE), 0.0)
    assert phone.service.get(phone.session).frames == 0
    # The same frame again, as a phone that got an error would send it.
    again = phone.send(room.view(HERE), 0.0)
    assert (again.frame, again.result.method, again.unaided_m) == (1, "rgbd", 0.0)
