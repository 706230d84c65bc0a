"""Axes of AR frameworks: what is ahead, to the right and above of a camera is so in each of them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from app.api.requests.axes import CONVENTIONS, NAMES, Axes, AxesName, Frames, parse_axes, parse_pose
from app.errors import InvalidInputError
from app.geometry.se3 import Pose
from tests.api.test_sessions import start
from tests.scenes import CAMERA_TEXT, View
from tests.server import Server, assert_problem
from tests.synthetic import random_pose

PAGE = Path(__file__).parents[2] / "docs" / "axes.md"


@dataclass(frozen=True)
class Definition:
    """A convention in words of its own documentation: directions in the camera, up in the world, and handedness."""

    right: tuple[int, int, int]
    up: tuple[int, int, int]
    forward: tuple[int, int, int]
    world_up: tuple[int, int, int]
    is_left_handed: bool = False
    units_per_m: float = 1.0


GL = Definition(right=(1, 0, 0), up=(0, 1, 0), forward=(0, 0, -1), world_up=(0, 1, 0))
DEFINITIONS: dict[AxesName, Definition] = {
    "opencv": Definition((1, 0, 0), (0, -1, 0), (0, 0, 1), (0, 0, 1)),
    "arkit": GL,
    "arcore": GL,
    "webxr": GL,
    "unity": Definition((1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 1, 0), is_left_handed=True),
    "unreal": Definition((0, 1, 0), (0, 0, 1), (1, 0, 0), (0, 0, 1), is_left_handed=True, units_per_m=100),
    "ros": Definition((0, -1, 0), (0, 0, 1), (1, 0, 0), (0, 0, 1)),
}
EACH = pytest.mark.parametrize("name", NAMES)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def test_every_convention_is_defined() -> None:
    assert set(DEFINITIONS) == set(CONVENTIONS) == set(NAMES)


@EACH
def test_a_point_seen_by_a_camera_is_where_it_should_be(name: AxesName, rng: np.random.Generator) -> None:
    axes, own = CONVENTIONS[name], DEFINITIONS[name]
    for _ in range(50):
        world_from_camera = random_pose(rng)
        right_m, up_m, ahead_m = rng.uniform(-2, 2, 3)
        in_world = (
            world_from_camera.rotation @ np.array([right_m, -up_m, ahead_m]) + world_from_camera.translation
        )
        in_camera = own.units_per_m * (
            right_m * np.array(own.right) + up_m * np.array(own.up) + ahead_m * np.array(own.forward)
        )
        converted = axes.pose_out(world_from_camera)
        found = converted.rotation @ in_camera + converted.translation
        assert axes.point_in(tuple(found)) == pytest.approx(in_world, abs=1e-9)


@EACH
def test_up_is_up_and_hands_are_as_defined(name: AxesName) -> None:
    axes, own = CONVENTIONS[name], DEFINITIONS[name]
    assert axes.world @ np.array([0, 0, 1]) == pytest.approx(np.array(own.world_up))
    hand = -1 if own.is_left_handed else 1
    assert np.linalg.det(axes.world) == pytest.approx(hand)
    assert np.linalg.det(axes.camera) == pytest.approx(hand)
    assert np.dot(np.cross(own.right, own.up), own.forward) == -hand


@EACH
def test_round_trips(name: AxesName, rng: np.random.Generator) -> None:
    axes = CONVENTIONS[name]
    for _ in range(100):
        a, b = random_pose(rng), random_pose(rng)
        assert axes.pose_in(axes.pose_out(a)).matrix == pytest.approx(a.matrix, abs=1e-9)
        assert axes.pose_out(axes.pose_in(a)).matrix == pytest.approx(a.matrix, abs=1e-9)
        # The motion between two cameras, as the framework computes it.
        theirs = axes.pose_out(a).inverse() @ axes.pose_out(b)
        assert axes.motion_in(theirs).matrix == pytest.approx((a.inverse() @ b).matrix, abs=1e-9)
        down = a.rotation.T @ np.array([0.0, 0, -1])
        in_theirs = axes.pose_out(a).rotation.T @ -np.array(DEFINITIONS[name].world_up)
        assert axes.direction_in(tuple(in_theirs)) == pytest.approx(down, abs=1e-9)


@EACH
def test_session_from_world_brings_a_point_of_the_world_into_the_apps_frame(
    name: AxesName, rng: np.random.Generator
) -> None:
    axes = CONVENTIONS[name]
    world_from_camera, session_from_camera = random_pose(rng), random_pose(rng)
    found = Frames(axes, session_from_camera).session_from_world(world_from_camera)
    assert found is not None
    # A place in the world is the same place seen from the camera, in both frames.
    in_camera = rng.uniform(-2, 2, 3)
    world = axes.pose_out(world_from_camera)
    in_world = world.rotation @ in_camera + world.translation
    in_session = session_from_camera.rotation @ in_camera + session_from_camera.translation
    assert found.rotation @ in_world + found.translation == pytest.approx(in_session, abs=1e-9)
    assert Frames(axes, None).session_from_world(world_from_camera) is None
    assert Frames(axes, session_from_camera).session_from_world(None) is None


def read(body: dict[str, Any]) -> Pose:
    return cast(Pose, parse_pose(json.dumps(body), "pose"))


def told(pose: Pose) -> str:
    position = dict(zip("xyz", pose.translation.tolist(), strict=True))
    quaternion = dict(zip("xyzw", pose.quaternion.tolist(), strict=True))
    return json.dumps({"position": position, "quaternion": quaternion})


@EACH
def test_a_query_is_answered_in_the_axes_that_it_names(
    museum: Server, queries: list[View], name: AxesName, rng: np.random.Generator
) -> None:
    axes, view = CONVENTIONS[name], queries[0]
    own = museum.locate(view.jpeg(), venue="museum")
    truth = view.world_from_camera
    down = axes.pose_out(truth).rotation.T @ -np.array(DEFINITIONS[name].world_up)
    device = random_pose(rng)
    fields = {"axes": name, "gravity": ",".join(map(str, down)), "device_pose": told(device)}
    answer = museum.locate(view.jpeg(), venue="museum", **fields)
    assert (answer["axes"], answer["gravity_checked"]) == (name, True)
    assert axes.pose_in(read(answer["pose"])).matrix == pytest.approx(read(own["pose"]).matrix, abs=1e-3)
    session_from_world = read(answer["session_from_world"])
    assert (session_from_world @ read(answer["pose"])).matrix == pytest.approx(device.matrix, abs=1e-4)
    assert own["session_from_world"] is None


@EACH
def test_motion_of_a_session_is_read_in_its_axes(museum: Server, queries: list[View], name: AxesName) -> None:
    axes: Axes = CONVENTIONS[name]
    first, second = queries[0].world_from_camera, queries[1].world_from_camera
    session = start(museum)
    answers = []
    for view, motion in (
        (queries[0], None),
        (queries[1], axes.pose_out(first).inverse() @ axes.pose_out(second)),
    ):
        data = {"camera": CAMERA_TEXT, "axes": name, **({} if motion is None else {"motion": told(motion)})}
        answer = museum.client.post(f"/sessions/{session}/frames", data=data, files={"image": view.jpeg()})
        answers.append(answer.json())
    assert answers[1]["located"]
    found = axes.pose_in(read(answers[1]["pose"]))
    assert np.linalg.norm(found.translation - second.translation) < 0.05
    trajectory = museum.client.get(f"/sessions/{session}", params={"axes": name}).json()["trajectory"]
    assert read(trajectory[1]["pose"]).matrix == pytest.approx(read(answers[1]["pose"]).matrix, abs=1e-5)


def test_unknown_axes_are_refused(museum: Server, queries: list[View]) -> None:
    answer = museum.post_image(queries[0].jpeg(), {"venue": "museum", "axes": "blender"})
    assert "arkit" in assert_problem(answer, 422, "invalid_input")
    answer = museum.post_image(queries[0].jpeg(), {"venue": "museum", "device_pose": "{}"})
    assert "device_pose" in assert_problem(answer, 422, "invalid_input")
    with pytest.raises(InvalidInputError):
        parse_axes("x")
    assert parse_axes(" ARKit ").name == "arkit"


def test_the_page_has_the_matrices_of_the_code() -> None:
    page = PAGE.read_text(encoding="utf-8")
    for name, axes in CONVENTIONS.items():
        row = next(line for line in page.splitlines() if line.startswith(f"| `{name}` |"))
        for matrix in (axes.world, axes.camera):
            assert written(matrix) in row, name


def written(matrix: np.ndarray) -> str:
    """Return what the rows of a matrix take, as the page writes it: `(x, z, -y)`."""
    letters = []
    for row in matrix.astype(int):
        place = int(np.flatnonzero(row)[0])
        letters.append(("-" if row[place] < 0 else "") + "xyz"[place])
    return f"({', '.join(letters)})"
