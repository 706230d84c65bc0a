"""POST /locate with several frames: one answer about the first, and a clear 4xx for each misuse."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace
from typing import Any

import httpx
import numpy as np
import pytest

from app.api.requests.axes import CONVENTIONS
from app.geometry.se3 import Pose
from tests.scenes import CAMERA, CAMERA_TEXT, Room, encode, pose_at
from tests.server import Server, assert_problem, pose_errors

FIRST = pose_at(1.7, 1.4, 1.5, 0.0, 1.0)
LATER = [pose_at(1.74, 1.42, 1.5, 3.0, 1.0), pose_at(1.78, 1.43, 1.51, 6.0, 1.0)]


@pytest.fixture(scope="module")
def burst(room: Room) -> list[bytes]:
    """The pictures of a burst."""
    return [room.view(pose).jpeg() for pose in (FIRST, *LATER)]


def motion_of(poses: list[Pose], first: Pose = FIRST) -> list[dict[str, Any]]:
    """Return poses relative to the first as the request has them."""
    found = []
    for pose in poses:
        relative = first.inverse() @ pose
        x, y, z = relative.translation
        qx, qy, qz, qw = relative.quaternion
        found.append(
            {"position": {"x": x, "y": y, "z": z}, "quaternion": {"x": qx, "y": qy, "z": qz, "w": qw}}
        )
    return found


def post(server: Server, pictures: list[bytes], **fields: str) -> httpx.Response:
    files = [("image", ("0.jpg", pictures[0])), *(("images", ("k.jpg", each)) for each in pictures[1:])]
    data = {"venue": "museum", "camera": CAMERA_TEXT, **fields}
    return server.client.post("/locate", data=data, files=files)


def located(answer: httpx.Response, frames: int = 3) -> dict[str, Any]:
    assert answer.status_code == 200, answer.text
    result: dict[str, Any] = answer.json()
    assert result["located"], result["reason"]
    error_m, error_deg = pose_errors(result, FIRST)
    assert error_m < 0.02
    assert error_deg < 0.5
    assert len(result["frames"]) == frames
    return result


def test_a_burst_with_motion_gets_one_answer(museum: Server, burst: list[bytes]) -> None:
    result = located(post(museum, burst, motion=json.dumps(motion_of(LATER))))
    assert all(frame["matches"] >= frame["inliers"] > 20 for frame in result["frames"])
    assert result["method"] == "rgbd"
    # A thing that all frames show counts once.
    assert result["inliers"] < sum(frame["inliers"] for frame in result["frames"])


def test_a_burst_without_motion_gets_one_answer(museum: Server, burst: list[bytes]) -> None:
    located(post(museum, burst))


def test_a_single_image_has_no_frames(museum: Server, burst: list[bytes]) -> None:
    located(post(museum, burst[:1]), frames=0)
    located(post(museum, burst[:1], motion="[]", cameras=""), frames=0)


def test_motion_may_be_matrices_and_in_other_axes(museum: Server, burst: list[bytes]) -> None:
    matrices = [(FIRST.inverse() @ pose).matrix.tolist() for pose in LATER]
    located(post(museum, burst, motion=json.dumps(matrices)))
    axes = CONVENTIONS["unreal"]
    there = [axes.pose_out(pose) for pose in (FIRST, *LATER)]
    fields = {"axes": "unreal", "motion": json.dumps(motion_of(there[1:], there[0]))}
    result = post(museum, burst, **fields).json()
    assert result["located"]
    x, y, z = (result["pose"]["position"][axis] for axis in "xyz")
    np.testing.assert_allclose([x, y, z], there[0].translation, atol=2.0)


def test_json_may_hold_further_images(museum: Server, burst: list[bytes]) -> None:
    texts = [base64.b64encode(each).decode() for each in burst]
    body = {
        "image": texts[0],
        "images": texts[1:],
        "venue": "museum",
        "camera": list(CAMERA.params),
        "motion": motion_of(LATER),
        "cameras": [CAMERA_TEXT, CAMERA_TEXT],
    }
    located(museum.client.post("/locate", json=body))


MOTION = motion_of(LATER)
FAR = [MOTION[0], {**MOTION[1], "position": {"x": 200.0, "y": 0, "z": 0}}]
NAN = {**MOTION[1], "position": {"x": float("nan"), "y": 0, "z": 0}}
SHEARED = [np.eye(4).tolist(), (np.eye(4) + 0.5).tolist()]
MISUSES: dict[str, tuple[dict[str, str], str]] = {
    "too few motions": ({"motion": json.dumps(MOTION[:1])}, "motion has 1 entries for 2 images"),
    "too many motions": ({"motion": json.dumps(MOTION * 2)}, "motion has 4 entries for 2 images"),
    "no list": ({"motion": json.dumps(MOTION[0])}, "JSON list"),
    "no JSON": ({"motion": "1,2,3"}, "motion is not JSON"),
    "no numbers": ({"motion": json.dumps([MOTION[0], {"position": {}, "quaternion": {}}])}, "motion\\[1\\]"),
    "not finite": ({"motion": json.dumps([MOTION[0], NAN])}, "finite"),
    "no rotation": ({"motion": json.dumps(SHEARED)}, "no rigid transform"),
    "no matrix": ({"motion": json.dumps([[1, 2], [3]])}, "no rigid transform"),
    "a matrix of text": ({"motion": json.dumps([[["a"] * 4] * 4] * 2)}, "no rigid transform"),
    "an unknown key": ({"motion": json.dumps([MOTION[0], {**MOTION[1], "time": 1}])}, "time"),
    "far": ({"motion": json.dumps(FAR)}, "200.0 m long"),
    "too few cameras": ({"cameras": json.dumps([CAMERA_TEXT])}, "cameras has 1 entries for 2 images"),
    "a bad camera": ({"cameras": json.dumps([CAMERA_TEXT, "1,2"])}, "4, 8 or 9 numbers"),
    "motion without a camera": ({"motion": json.dumps(MOTION), "camera": ""}, "intrinsics"),
    "a missing camera": ({"motion": json.dumps(MOTION), "cameras": json.dumps([CAMERA_TEXT, None])}, "intrinsics"),
    "vdm": ({"method": "vdm"}, "auto or rgbd"),
    "anchor": ({"method": "anchor"}, "auto or rgbd"),
}  # fmt: skip


@pytest.mark.parametrize("name", MISUSES)
def test_a_misuse_is_a_422_that_says_what_to_change(museum: Server, burst: list[bytes], name: str) -> None:
    fields, sentence = MISUSES[name]
    detail = assert_problem(post(museum, burst, **fields), 422)
    assert re.search(sentence, detail), detail


def test_frames_are_bounded_in_number_and_in_pixels(museum: Server, burst: list[bytes]) -> None:
    detail = assert_problem(post(museum, [burst[0]] * 9), 422)
    assert "at most 8 frames" in detail
    large = encode(np.zeros((5000, 5200), np.uint8), ".png")
    detail = assert_problem(post(museum, [burst[0], large, large], camera=""), 413, "image_too_large")
    assert "images[1]" in detail
    assert "all together" in detail


def test_a_bad_further_picture_is_named(museum: Server, burst: list[bytes]) -> None:
    assert "images[1]" in assert_problem(post(museum, [*burst[:2], b"no picture"]), 415, "unsupported_image")
    assert "images[0]" in assert_problem(post(museum, [burst[0], b""]), 422, "invalid_image")


def test_further_frames_without_image_are_refused(museum: Server, burst: list[bytes]) -> None:
    files = [("images", ("k.jpg", each)) for each in burst]
    assert_problem(museum.client.post("/locate", data={"venue": "museum"}, files=files), 422)


def test_all_pictures_together_are_bounded_in_bytes(museum: Server, burst: list[bytes]) -> None:
    heavy = burst[0] + bytes(9_000_000)
    assert_problem(post(museum, [heavy] * 3), 413)


def test_a_contradicted_motion_is_ambiguous(museum: Server, room: Room, burst: list[bytes]) -> None:
    false = [Pose(pose.rotation, pose.translation + np.array([0.6, 0.0, 0.0])) for pose in LATER]
    result = post(museum, burst, motion=json.dumps(motion_of(false))).json()
    assert (result["located"], result["reason"], result["pose"]) == (False, "ambiguous", None)


def test_gravity_is_that_of_the_first_picture(museum: Server, room: Room) -> None:
    views = [room.view(pose) for pose in (FIRST, *LATER)]
    turned = [replace(view, rgb=np.ascontiguousarray(np.rot90(view.rgb, 3))) for view in views]
    fx, fy, cx, cy = CAMERA.params
    camera = f"{fy},{fx},{CAMERA.height - 1 - cy},{cx}"
    fields = {"camera": camera, "gravity": "-1,0,0"}
    result = post(museum, [view.jpeg() for view in turned], **fields).json()
    assert result["located"], result["reason"]
    assert result["camera"]["width"] == CAMERA.height
