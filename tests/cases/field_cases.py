"""Inputs from the field beside the repository, each with what is right; and comparing an answer with that."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from app.geometry.se3 import Pose
from tests.server import POLL_S, Server, pose_errors, wait_for

FOLDER = Path(__file__).resolve().parents[2].parent / "shared" / "cases"
RIGHT = "00-right"
# The venue that holds the map of the right scan; a recorded request names it.
VENUE = "m00right"
CAMERA = "300.0,300.0,159.5,119.5"

RIGHT_M = 0.005
RIGHT_DEG = 0.1
CONVERTED_M = 0.01
CONVERTED_DEG = 0.3
# A build takes seconds; examinations and repairs come on top.
BUILD_S = 200.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanCase:
    """A scan as it was sent and what is right for it.

    `readable`: a map whose queries are located is right. `refusal`: a build that fails with a sentence in which all of
    these patterns are found is right. `warning`: so is a map whose report has all of these. `keeps_frame` is False for
    a scan whose world isn't that of the right scan.
    """

    name: str
    readable: bool = False
    refusal: tuple[str, ...] = ()
    warning: tuple[str, ...] = ()
    keeps_frame: bool = True


def folder_of(name: str) -> Path:
    """Return a case's folder, or skip the test where the cases are not beside the repository."""
    if not FOLDER.is_dir():
        pytest.skip("the cases from the field are not beside the repository")
    return FOLDER / name


def json_of(name: str, file: str) -> Any:
    """Return the contents of a case's JSON file."""
    return json.loads((folder_of(name) / file).read_text())


def options_of(name: str) -> dict[str, Any]:
    """Return the options that a scan was sent with."""
    path = folder_of(name) / "options.json"
    return dict(json.loads(path.read_text())) if path.exists() else {}


def pictures_of(name: str) -> list[Path]:
    """Return a case's query pictures in order."""
    return sorted(path for path in folder_of(name).iterdir() if path.name.startswith("query-"))


def right_poses() -> list[Pose]:
    """Return where the queries of the right scan were taken."""
    queries = json_of(RIGHT, "truth.json")["queries"]
    return [Pose.from_matrix(rounded(queries[name]["world_from_camera"])) for name in sorted(queries)]


def rounded(matrix: object) -> NDArray[np.float64]:
    """Return a matrix that was written with six digits."""
    return np.asarray(matrix, dtype=np.float64)


def build(server: Server, venue: str, archive: Path, options: dict[str, Any]) -> dict[str, Any]:
    """Return the build of an archive once it has ended."""
    answer = server.submit(archive.read_bytes(), venue, options)
    if answer.status_code != 202:
        return {"state": "failed", "error": answer.json()["detail"], "report": None}
    name = answer.json()["build"]
    ended = ("succeeded", "failed", "cancelled")
    return wait_for(
        lambda: body if (body := server.status(name))["state"] in ended else None, BUILD_S, POLL_S
    )


def sentence_of(built: dict[str, Any]) -> str:
    """Return why a build failed."""
    error = built["error"]
    return str(error.get("detail", error)) if isinstance(error, dict) else str(error)


def says(text: str, patterns: tuple[str, ...]) -> bool:
    """Whether all of the patterns are in a text, whatever their case."""
    return bool(patterns) and all(re.search(pattern, text, re.IGNORECASE) for pattern in patterns)


def locate(server: Server, picture: Path, venue: str, camera: str = CAMERA) -> dict[str, Any]:
    """Return the answer to a picture, with the status of a refused one."""
    answer = server.client.post(
        "/locate",
        data={"venue": venue, "camera": camera},
        files={"image": (picture.name, picture.read_bytes())},
    )
    return {"status": answer.status_code, **answer.json()}


def located_as_right(server: Server, venue: str, keeps_frame: bool) -> str:
    """Return what is wrong with the answers of a venue to the right scan's queries, or nothing.

    Where the world is another one, the queries' poses against each other are compared.
    """
    answers = [locate(server, picture, venue) for picture in pictures_of(RIGHT)]
    if not all(answer.get("located") for answer in answers):
        return f"located {sum(bool(answer.get('located')) for answer in answers)} of {len(answers)}"
    truths = right_poses()
    if keeps_frame:
        errors = [pose_errors(answer, truth) for answer, truth in zip(answers, truths, strict=True)]
        limit_m, limit_deg = RIGHT_M, RIGHT_DEG
    else:
        found = [pose_of(answer) for answer in answers]
        pairs = [
            (found[0].inverse() @ pose, truths[0].inverse() @ truth)
            for pose, truth in zip(found[1:], truths[1:], strict=True)
        ]
        errors = [pose_errors(json_pose(pose), truth) for pose, truth in pairs]
        limit_m, limit_deg = CONVERTED_M, CONVERTED_DEG
    worst_m, worst_deg = max(m for m, _ in errors), max(deg for _, deg in errors)
    return (
        ""
        if worst_m <= limit_m and worst_deg <= limit_deg
        else f"{worst_m:.3f} m, {worst_deg:.2f} degrees off"
    )


def pose_of(answer: dict[str, Any]) -> Pose:
    """Return the pose of an answer."""
    p, q = answer["pose"]["position"], answer["pose"]["quaternion"]
    return Pose.from_quaternion([p["x"], p["y"], p["z"]], [q["x"], q["y"], q["z"], q["w"]])


def json_pose(pose: Pose) -> dict[str, Any]:
    """Return a pose as an answer has it."""
    position = dict(zip("xyz", pose.translation.tolist(), strict=True))
    return {
        "pose": {"position": position, "quaternion": dict(zip("xyzw", pose.quaternion.tolist(), strict=True))}
    }
