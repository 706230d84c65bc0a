"""Rows of lists and trajectories as people print them: read where that is beyond doubt, else refused by their line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from app.errors import InvalidScanError
from app.geometry.camera_hint import CameraHint
from app.geometry.se3 import Pose
from app.importers.frames import Scan, ScanOptions
from app.importers.registry import open_scan
from app.importers.rows.image_rows import parse_associations, parse_image_list
from app.importers.rows.trajectory_rows import parse_trajectory
from tests.importers.scans import INTRINSICS, write_seven_scenes, write_tum

TIMES_S = [0.0, 0.1, 0.2, 0.3]


def poses() -> list[Pose]:
    """Return a pose for each time, none of them symmetric in anything."""
    rng = np.random.default_rng(3)
    turns = rng.normal(size=(len(TIMES_S), 4))
    return [Pose.from_quaternion(rng.normal(size=3), q / np.linalg.norm(q)) for q in turns]


def tum_with(folder: Path, rows: list[str], times: list[float] | None = None) -> Scan:
    write_tum(folder, times or TIMES_S)
    (folder / "groundtruth.txt").write_text("\n".join(rows) + "\n")
    return open_scan(folder, "tum")


def assert_poses(scan: Scan) -> None:
    assert len(scan.frames) == len(TIMES_S)
    for frame, pose in zip(scan.frames, poses(), strict=True):
        np.testing.assert_allclose(frame.scan_from_camera.matrix, pose.matrix, atol=1e-5)


def numbers_of(pose: Pose) -> list[float]:
    return [*pose.translation, *pose.quaternion]


def row(
    time: str, values: list[float] | np.ndarray[tuple[int, ...], np.dtype[np.float64]], apart: str = " "
) -> str:
    return apart.join([time, *(f"{v:.7f}" for v in np.ravel(values))])


@pytest.mark.parametrize("apart", [" ", "\t", ",", ", ", ";", " ; "])
def test_separators(tmp_path: Path, apart: str) -> None:
    lines = [row(f"{t:.3f}", numbers_of(p), apart) for t, p in zip(TIMES_S, poses(), strict=True)]
    assert_poses(tum_with(tmp_path, lines))


@pytest.mark.parametrize("apart", [" ", "\t", ";", "; "])
def test_decimal_commas(tmp_path: Path, apart: str) -> None:
    lines = [
        row(f"{t:.3f}", numbers_of(p), apart).replace(".", ",") for t, p in zip(TIMES_S, poses(), strict=True)
    ]
    assert_poses(tum_with(tmp_path, lines))


def test_decimal_commas_between_commas_are_refused(tmp_path: Path) -> None:
    lines = [row("0,100", numbers_of(poses()[0]), ",").replace(".", ",")]
    with pytest.raises(InvalidScanError, match=r"groundtruth\.txt line 1: .* found 16: decimal commas\?"):
        tum_with(tmp_path, lines)
    with pytest.raises(
        InvalidScanError, match=r"line 1: expected 8 columns.* found 10: decimal commas\? .* points"
    ):
        parse_trajectory("1 2,5 3 4 5,5 6 7 8.5\n", "groundtruth.txt")


@pytest.mark.parametrize("by_columns", [False, True])
@pytest.mark.parametrize("rows", [3, 4])
def test_matrices(tmp_path: Path, rows: int, by_columns: bool) -> None:
    # The first pose at the origin: alone, it could be read both ways.
    matrices = [pose.matrix[:rows] for pose in poses()]
    lines = [row(f"{t:.3f}", m.T if by_columns else m) for t, m in zip(TIMES_S, matrices, strict=True)]
    scan = tum_with(tmp_path, lines)
    assert_poses(scan)
    assert scan.notes == (
        f"The poses of groundtruth.txt were read as {rows}x4 matrices by {'columns' if by_columns else 'rows'}.",
    )


def test_matrices_without_times_go_by_order(tmp_path: Path) -> None:
    lines = [row(f"{p.matrix[0, 0]:.7f}", p.matrix[:3].ravel()[1:]) for p in poses()]
    scan = tum_with(tmp_path, lines)
    assert_poses(scan)
    assert "in their order" in scan.notes[-1]
    with pytest.raises(InvalidScanError, match="3 rows of a matrix without a time for 4 colour images"):
        tum_with(tmp_path, lines[:3])


def test_an_id_behind_the_pose(tmp_path: Path) -> None:
    lines = [
        f"{row(f'{t:.3f}', numbers_of(p))} {i}" for i, (t, p) in enumerate(zip(TIMES_S, poses(), strict=True))
    ]
    assert_poses(tum_with(tmp_path, lines))


@pytest.mark.parametrize("comment", ["", "# "])
def test_a_header_names_the_order(tmp_path: Path, comment: str) -> None:
    """The layout of EuRoC: scalar first, units in brackets."""
    header = (
        comment
        + "timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"
    )
    lines = [
        row(f"{t:.3f}", [*p.translation, *np.roll(p.quaternion, 1)], ",")
        for t, p in zip(TIMES_S, poses(), strict=True)
    ]
    scan = tum_with(tmp_path, [header, *lines])
    assert_poses(scan)
    assert scan.notes == ("The columns of groundtruth.txt were read in the order that its header names.",)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 0 0 0 0 0 0\n", "line 1: expected 8 columns, .*, and found 7"),
        (
            "1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0\n3 0 0 0 0 0 0 1",
            "line 2: .* found 7, where the other rows have 8",
        ),
        ("1 0 0 0 0 0 0 1\n\n# x\n2 0 0 0 0 0 0 1 9 9", "line 4: .* found 10, where the other rows have 8"),
        ("1 0 0 0 0 0 0 1 0.5", "found 9"),
        ("1 0 0 0 0 0 0 1 0.5 1 1", "found 11"),
        ("1 2 3 4 90 45 10 5", "line 1: the last four columns must be a unit quaternion .* length is 101"),
        ("# none\n", "groundtruth.txt lists none"),
        ("1 0 0 0 0 0 0 one", "line 1: '1 0 0 0 0 0 0 one' must be numbers"),
    ],
)
def test_what_cannot_be_read_is_named(text: str, message: str) -> None:
    with pytest.raises(InvalidScanError, match=message):
        parse_trajectory(text, "groundtruth.txt")


@pytest.mark.parametrize(
    ("unit", "per_s"), [("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9)]
)
@pytest.mark.parametrize("start_s", [0.0, 1305031100.0])
def test_poses_in_another_unit(tmp_path: Path, unit: str, per_s: float, start_s: float) -> None:
    times = [start_s + 0.1 * i for i in range(len(TIMES_S))]
    lines = [row(f"{t * per_s:.0f}", numbers_of(p)) for t, p in zip(times, poses(), strict=True)]
    if start_s == 0.0:
        # One image in four meets the first row by chance; more of them don't.
        times = [start_s + 0.1 * i for i in range(8)]
        lines += [row(f"{t * per_s:.0f}", numbers_of(poses()[0])) for t in times[4:]]
    scan = tum_with(tmp_path, lines, times)
    assert len(scan.frames) == len(times)
    assert scan.notes == (f"The times of groundtruth.txt were read as {unit}.",)


def test_times_that_never_meet_are_both_given(tmp_path: Path) -> None:
    lines = [row(f"{t + 500:.3f}", numbers_of(p)) for t, p in zip(TIMES_S, poses(), strict=True)]
    with pytest.raises(InvalidScanError) as error:
        tum_with(tmp_path, lines)
    assert "4 no_pose" in str(error.value)
    assert "rgb.txt runs from 0 to 0.3 s, groundtruth.txt runs from 500 to 500.3 s." in str(error.value)


def test_all_rows_at_one_time(tmp_path: Path) -> None:
    lines = [row("1.30503e+09", numbers_of(p)) for p in poses()]
    with pytest.raises(
        InvalidScanError, match=r"All rows of groundtruth\.txt have the time 1305030000: print more"
    ):
        tum_with(tmp_path, lines)


def test_image_lists() -> None:
    text = (
        'timestamp,filename\n0.5,rgb/a.png\n1305031100,25 rgb/b.png\n7;\'rgb/c d.png\'\n"8.5" "rgb/e.png"\n'
    )
    found = parse_image_list(text, "rgb.txt", "colour")
    assert found.times_s.tolist() == [0.5, 1305031100.25, 7, 8.5]
    assert found.names == ("rgb/a.png", "rgb/b.png", "rgb/c d.png", "rgb/e.png")
    assert found.places[0] == "rgb.txt line 2"


def test_associations_in_both_orders() -> None:
    both = parse_associations("0.1 rgb/a b.png 0.2 depth/1.png\n", "associations.txt")
    assert both is not None
    assert [(list(rows.times_s), rows.names) for rows in both] == [
        ([0.1], ("rgb/a b.png",)),
        ([0.2], ("depth/1.png",)),
    ]
    turned = parse_associations("0.2,depth/1.png,0.1,rgb/1.png\n", "associations.txt")
    assert turned is not None
    assert turned[0].names == ("rgb/1.png",)
    for text in ("0.1 rgb/1.png\n", "", "0.1 rgb/2 3 images/1.png\n"):
        assert parse_associations(text, "rgb.txt") is None


@pytest.mark.parametrize("columns", [False, True])
@pytest.mark.parametrize("rows", [3, 4])
def test_pose_files(tmp_path: Path, rows: int, columns: bool) -> None:
    write_seven_scenes(tmp_path)
    for i, pose in enumerate(poses()[:3]):
        matrix = pose.matrix[:rows]
        np.savetxt(tmp_path / f"frame-{i:06d}.pose.txt", matrix.T if columns else matrix)
    scan = open_scan(tmp_path, "7scenes", ScanOptions(camera=CameraHint(values=INTRINSICS)))
    for frame, pose in zip(scan.frames, poses()[:3], strict=True):
        np.testing.assert_allclose(frame.scan_from_camera.matrix, pose.matrix, atol=1e-9)
    assert len(scan.notes) == int(columns)


def test_pose_files_of_another_length_are_named(tmp_path: Path) -> None:
    write_seven_scenes(tmp_path)
    for i in range(3):
        (tmp_path / f"frame-{i:06d}.pose.txt").write_text("0 0 0 0 0 0 1")
    with pytest.raises(
        InvalidScanError, match=r"frame-000000\.pose\.txt has 7 numbers, a pose has 16 or, .* 12"
    ):
        open_scan(tmp_path, "7scenes", ScanOptions(camera=CameraHint(values=INTRINSICS)))
