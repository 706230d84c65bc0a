"""A scan examined: right ones are confirmed, mistakes are named with the option that mends them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.engine.mapping.examination.outcome import RefusedScanError
from app.geometry.camera_hint import hint_of
from app.geometry.se3 import Pose
from app.importers.conventions import PoseConvention
from tests.engine.mapping.examination.scans import (
    OPTIONS,
    Files,
    examined,
    with_images,
    with_poses,
    write,
    written,
)
from tests.scenes import CAMERA, DEPTH_SCALE, Room, View, pose_at, scan_files


def test_a_right_scan_is_confirmed(views: list[View], tmp_path: Path) -> None:
    found = examined(write(scan_files(views), tmp_path))
    assert (found.verdict, found.findings, found.remedy) == ("confirmed", (), None)
    assert found.figures["pairs"] >= 8
    assert found.figures["epipolar_error_px"] < 0.5
    assert found.figures["depth_ratio"] == pytest.approx(1.0, abs=0.02)


CONVENTIONS = {
    "OpenGL": (PoseConvention(axes="rub"), "camera_axes", {"axes": "opengl"}),
    "ROS": (PoseConvention(axes="flu"), "camera_axes", {"axes": "ros"}),
    "camera_from_world": (
        PoseConvention(poses="camera_from_world"),
        "inverted_poses",
        {"poses": "camera_from_world"},
    ),
    "w first": (PoseConvention(quaternion="wxyz"), "quaternion_order", {"quaternion": "wxyz"}),
    "turned": (PoseConvention(rotate_deg=90), "turned_pictures", {"rotate_deg": 90}),
    "millimetres": (PoseConvention(position_scale=1000.0), "position_scale", {"position_scale": 1000.0}),
}


@pytest.mark.parametrize("name", CONVENTIONS)
def test_poses_written_another_way_are_named(name: str, views: list[View], tmp_path: Path) -> None:
    convention, code, remedy = CONVENTIONS[name]
    folder = write(with_poses(views, written(convention)), tmp_path)
    # Gravity follows from poses that are read rightly.
    found = examined(folder, {"camera": list(CAMERA.params), "world_from_scan": np.eye(4).tolist()})
    assert found.verdict == "refused"
    assert [finding.code for finding in found.wrong] == [code]
    assert found.remedy == remedy
    mended = examined(folder, {**OPTIONS, **remedy})
    assert (mended.verdict, mended.wrong) == ("confirmed", ())


def test_two_mistakes_are_both_named(views: list[View], tmp_path: Path) -> None:
    folder = write(with_poses(views, written(PoseConvention(axes="rub"))), tmp_path)
    found = examined(folder, {**OPTIONS, "depth_scale": DEPTH_SCALE / 5})
    assert found.remedy == {"axes": "opengl", "depth_scale": DEPTH_SCALE}
    assert '"axes": "opengl"' in str(RefusedScanError(found))
    assert '"repair": true' in str(RefusedScanError(found))


OPTION_MISTAKES: dict[str, tuple[dict[str, Any], str]] = {
    "depth_scale": ({"depth_scale": 1000}, "depth_scale"),
    "focal length": ({"camera": [300, 300, 159.5, 119.5]}, "focal_length"),
    "gravity": ({"gravity": [0, 0, 1]}, "gravity_up"),
}


@pytest.mark.parametrize("name", OPTION_MISTAKES)
def test_wrong_options_are_named(name: str, views: list[View], tmp_path: Path) -> None:
    options, code = OPTION_MISTAKES[name]
    found = examined(write(scan_files(views), tmp_path), {**OPTIONS, **options})
    assert [finding.code for finding in found.wrong] == [code]
    assert found.remedy is not None
    mended = examined(tmp_path, {**OPTIONS, **options, **found.remedy})
    assert mended.verdict == "confirmed"


def test_the_focal_length_is_estimated(views: list[View], tmp_path: Path) -> None:
    found = examined(write(scan_files(views), tmp_path), {**OPTIONS, "camera": [300, 300, 159.5, 119.5]})
    assert found.remedy is not None
    assert found.remedy["camera"]["params"][0] == pytest.approx(CAMERA.focal_px, rel=0.01)


def test_late_poses_are_named_with_their_offset(views: list[View], tmp_path: Path) -> None:
    folder = write(with_poses(views, lambda poses: [poses[0], *poses[:-1]]), tmp_path)
    found = examined(folder)
    assert [finding.code for finding in found.wrong] == ["time_offset"]
    assert found.remedy is not None
    assert found.remedy["time_offset_s"] == pytest.approx(0.1, abs=0.01)


def mirrored(files: Files) -> Files:
    return with_images(files, lambda image: image[:, ::-1], lambda raw: raw[:, ::-1])


def swapped(files: Files) -> Files:
    return with_images(files, lambda image: image, lambda raw: raw.byteswap())


def test_mirrored_pictures_are_named_and_not_repaired(views: list[View], tmp_path: Path) -> None:
    found = examined(write(mirrored(scan_files(views)), tmp_path))
    assert ([finding.code for finding in found.wrong], found.remedy) == (["mirrored_pictures"], None)


def test_pictures_upside_down_in_a_mirror_are_not_taken_for_left_handed_axes(
    views: list[View], tmp_path: Path
) -> None:
    files = with_images(scan_files(views), lambda image: image[::-1], lambda raw: raw[::-1])
    found = examined(write(files, tmp_path))
    assert ([finding.code for finding in found.wrong], found.remedy) == (["mirrored_pictures"], None)
    assert "top for bottom" in found.wrong[0].sentence


def test_exchanged_bytes_of_depth_are_named(views: list[View], tmp_path: Path) -> None:
    found = examined(write(swapped(scan_files(views)), tmp_path))
    assert [finding.code for finding in found.wrong] == ["depth_byte_order"]
    assert examined(tmp_path, {**OPTIONS, "swap_depth_bytes": True}).verdict == "confirmed"


def test_distances_along_the_rays_are_named(views: list[View], tmp_path: Path) -> None:
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    rays = CAMERA.unproject(np.stack([u, v], axis=-1).reshape(-1, 2), np.ones(u.size))
    lengths = np.linalg.norm(rays, axis=1).reshape(u.shape)
    far = [View(view.world_from_camera, view.rgb, view.depth_m * lengths) for view in views]
    found = examined(write(scan_files(far), tmp_path))
    assert [finding.code for finding in found.wrong] == ["depth_along_rays"]
    assert examined(tmp_path, {**OPTIONS, "depth_along_rays": True}).verdict == "confirmed"


def test_poses_that_stand_still_are_named(views: list[View], tmp_path: Path) -> None:
    found = examined(write(with_poses(views, lambda poses: [poses[0]] * len(poses)), tmp_path))
    assert [finding.code for finding in found.wrong] == ["poses_stand_still"]
    assert found.remedy is None


def test_poses_of_another_walk_are_refused_without_a_cause(views: list[View], tmp_path: Path) -> None:
    rng = np.random.default_rng(0)

    def others(poses: list[Pose]) -> list[Pose]:
        return [pose_at(*rng.uniform(1, 2, 3), *rng.uniform(-40, 40, 2)) for _ in poses]

    found = examined(write(with_poses(views, others), tmp_path))
    assert ([finding.code for finding in found.wrong], found.remedy) == (["poses_disagree"], None)


def test_a_scan_of_blank_walls_is_unknown_and_not_refused(views: list[View], tmp_path: Path) -> None:
    blank = [View(view.world_from_camera, np.full_like(view.rgb, 200), view.depth_m) for view in views]
    found = examined(write(scan_files(blank), tmp_path))
    assert (found.verdict, found.wrong) == ("unknown", ())
    assert "record more frames" not in found.findings[-1].sentence
    assert len(found.warnings) == 1


def test_frames_that_share_no_view_are_unknown_and_told_to_be_more(room: Room, tmp_path: Path) -> None:
    turned = [room.view(pose_at(2.0, 1.5, yaw_deg=90.0 * turn)) for turn in range(4)]
    found = examined(write(scan_files(turned), tmp_path))
    assert (found.verdict, found.wrong) == ("unknown", ())
    assert "turned by 90 degrees from each other: record more frames" in found.findings[-1].sentence


def test_a_world_whose_y_is_up_is_warned_of(views: list[View], tmp_path: Path) -> None:
    y_up = Pose(np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]]), np.zeros(3))
    folder = write(with_poses(views, lambda poses: [y_up @ pose for pose in poses]), tmp_path)
    without = examined(folder, {"camera": list(CAMERA.params)})
    assert (without.verdict, [finding.code for finding in without.findings]) == ("confirmed", ["up_is_not_z"])
    assert without.findings[0].options == {"gravity": [0, -1, 0]}
    assert examined(folder, {"camera": list(CAMERA.params), "gravity": [0, -1, 0]}).findings == ()


def test_a_world_whose_z_is_up_needs_no_warning(views: list[View], tmp_path: Path) -> None:
    folder = write(scan_files(views), tmp_path)
    assert examined(folder, {"camera": list(CAMERA.params)}).findings == ()


def test_an_examination_can_be_stopped(views: list[View], tmp_path: Path) -> None:
    from concurrent.futures import ThreadPoolExecutor

    from app.engine.mapping.examination.examine import examine_scan
    from app.errors import CancelledBuildError
    from app.importers.frames import ScanOptions
    from app.importers.registry import open_scan

    class Stopped:
        def report(self, stage: str, done: int, total: int) -> None:
            if stage == "examine" and done:
                raise CancelledBuildError("Stopped.")

    options = ScanOptions(camera=hint_of(CAMERA))
    scan = open_scan(write(scan_files(views), tmp_path), "tum", options)
    with ThreadPoolExecutor(1) as executor, pytest.raises(CancelledBuildError):
        examine_scan(scan, options, (0.0, 0.0, -1.0), executor, Stopped())
