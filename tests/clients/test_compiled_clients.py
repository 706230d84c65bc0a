"""The Kotlin sample and the Swift client, compiled, place content by a real server; the parts of Android and ARCore
that the sample uses are those of tests/clients/device."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from roomfix_client import Roomfix

from tests.clients.conftest import Site

CLIENTS = Path(__file__).parents[2] / "clients"
DEVICE = Path(__file__).parent / "device"
KOTLIN = Path("/usr/share/kotlin/kotlinc/lib")
JSON = Path("/usr/share/java/com.android.json.jar")
SHIFT_M = np.array([0.5, -1.0, 2.0])
Program = Callable[..., list[str]]

with_kotlin = pytest.mark.skipif(
    shutil.which("kotlinc") is None or not JSON.is_file(),
    reason="kotlinc is not installed: apt-get install kotlin libandroid-json-java",
)
with_swift = pytest.mark.skipif(shutil.which("swiftc") is None, reason="swiftc is not installed")


def run(*command: str | Path) -> str:
    ran = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return ran.stdout


@pytest.fixture(scope="module")
def kotlin(site: Site, tmp_path_factory: pytest.TempPathFactory) -> Program:
    folder = tmp_path_factory.mktemp("kotlin")
    libraries = f"{JSON}:{KOTLIN / 'kotlin-stdlib-jdk7.jar'}"
    sources = [CLIENTS / "kotlin" / "src" / "main" / "kotlin" / "roomfix", *sorted(DEVICE.glob("*.kt"))]
    run("kotlinc", "-Werror", "-cp", libraries, *sources, "-d", folder)
    picture = cv2.imread(str(site.folder / "photo.jpg"))
    (folder / "photo.yuv").write_bytes(cv2.cvtColor(picture, cv2.COLOR_BGR2YUV_I420).tobytes())
    height, width = picture.shape[:2]

    def locate(token: str, pose: str) -> list[str]:
        path = f"{folder}:{libraries}:{KOTLIN / 'kotlin-stdlib.jar'}"
        given = [
            site.url,
            token,
            str(folder / "photo.yuv"),
            str(width),
            str(height),
            site.names["CAMERA"],
            pose,
        ]
        return run("java", "-cp", path, "LocateKt", *given).splitlines()

    return locate


@pytest.fixture(scope="module")
def swift(site: Site, tmp_path_factory: pytest.TempPathFactory) -> Program:
    folder = tmp_path_factory.mktemp("swift")
    sources = sorted((CLIENTS / "swift" / "Sources" / "RoomfixClient").glob("*.swift"))
    library = ["-emit-library", "-emit-module", "-module-name", "RoomfixClient"]
    run("swiftc", *library, "-warnings-as-errors", "-o", folder / "libRoomfixClient.so", *sources)
    linked = ["-I", folder, "-L", folder, "-lRoomfixClient", "-Xlinker", "-rpath", "-Xlinker", folder]
    program = folder / "locate"
    run("swiftc", "-parse-as-library", "-warnings-as-errors", *linked, "-o", program, DEVICE / "locate.swift")

    def locate(token: str, pose: str) -> list[str]:
        photo = site.folder / "photo.jpg"
        return run(program, site.url, token, photo, site.names["CAMERA"], pose).splitlines()

    return locate


@pytest.mark.parametrize(
    ("language", "axes"),
    [pytest.param("kotlin", "arcore", marks=with_kotlin), pytest.param("swift", "arkit", marks=with_swift)],
)
def test_a_compiled_client_places_content(
    site: Site, language: str, axes: Any, request: pytest.FixtureRequest
) -> None:
    program: Program = request.getfixturevalue(language)
    with Roomfix(site.url, site.names["KEY"]) as server:
        found = server.locate(
            site.folder / "photo.jpg", venue="museum", camera=site.names["CAMERA"], axes=axes
        )
        token = server.create_token("museum")["token"]
    assert found["pose"] is not None
    position, quaternion = (
        np.array(list(found["pose"][part].values())) for part in ("position", "quaternion")
    )
    # A session whose axes are the world's, moved: where the phone is in it is where it is in the world.
    pose = ",".join(f"{number:.7f}" for number in (*(position + SHIFT_M), *quaternion))
    located, placed = program(token, pose)
    assert located.lower() == "true 0"
    numbers = np.array(placed.split(), dtype=float)
    assert np.abs(numbers[:3] - SHIFT_M).max() < 0.05
    assert abs(numbers[6]) > np.cos(np.deg2rad(0.5))
    assert program("wrong", pose) == ["401 unauthenticated"]
