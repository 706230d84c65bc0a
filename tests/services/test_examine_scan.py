"""A scan is read another way when `repair` is given and the remedy is beyond doubt."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from app.engine.mapping.examination.outcome import RefusedScanError
from app.engine.mapping.loops.close import close_loops
from app.engine.mapping.options import parse_build_options
from app.engine.progress import NoProgress
from app.importers.conventions import PoseConvention
from app.importers.registry import open_scan
from app.services.examine_scan import ExaminedScan, examined_scan
from tests.drifting import around, drifted
from tests.engine.mapping.examination.scans import OPTIONS, with_poses, write, written
from tests.rendered_maps import models
from tests.scenes import DEPTH_SCALE, Room, View, scan_files


@pytest.fixture(scope="module")
def executor() -> Iterator[Executor]:
    with ThreadPoolExecutor(2) as workers:
        yield workers


def examine(folder: Path, executor: Executor, **options: Any) -> ExaminedScan:
    values = {**OPTIONS, **options}
    parsed = parse_build_options(values)
    scan = open_scan(folder, parsed.format, parsed.scan)
    return examined_scan(folder, scan, values, executor, NoProgress())


def test_a_right_scan_passes_as_it_is(views: list[View], executor: Executor, tmp_path: Path) -> None:
    found = examine(write(scan_files(views), tmp_path), executor, repair=True)
    assert (found.repairs, found.repairs_report(), found.warnings) == ((), {}, ())


def test_two_mistakes_are_repaired_and_said(views: list[View], executor: Executor, tmp_path: Path) -> None:
    folder = write(with_poses(views, written(PoseConvention(axes="rub"))), tmp_path)
    with pytest.raises(RefusedScanError, match="opengl"):
        examine(folder, executor, depth_scale=DEPTH_SCALE / 5)
    found = examine(folder, executor, depth_scale=DEPTH_SCALE / 5, repair=True)
    report = found.repairs_report()
    assert next(iter(report)) == "repaired"
    assert report["repairs"] == {"axes": "opengl", "depth_scale": DEPTH_SCALE}
    assert found.scan.depth.scale == DEPTH_SCALE
    for frame, view in zip(found.scan.frames, views, strict=True):
        assert frame.scan_from_camera.matrix == pytest.approx(view.world_from_camera.matrix, abs=1e-6)


def test_what_has_no_certain_remedy_stays_refused(
    views: list[View], executor: Executor, tmp_path: Path
) -> None:
    folder = write(with_poses(views, lambda poses: [poses[0]] * len(poses)), tmp_path)
    with pytest.raises(RefusedScanError, match="stand still") as refused:
        examine(folder, executor, repair=True)
    assert "repair" not in str(refused.value)


def test_drift_that_its_own_loops_mend_is_no_reason_to_refuse_a_scan(
    room: Room, executor: Executor, tmp_path: Path
) -> None:
    views = [room.view(pose) for pose in around(2, 32)]
    folder = write(with_poses(views, lambda poses: drifted(poses, 0.03, 0.012)), tmp_path)
    parsed = parse_build_options(OPTIONS)
    scan = open_scan(folder, parsed.format, parsed.scan)
    with pytest.raises(RefusedScanError) as refused:
        examined_scan(folder, scan, OPTIONS, executor, NoProgress())
    assert [finding.code for finding in refused.value.examination.wrong] == ["poses_drift"]
    close = partial(close_loops, models=models(), executor=executor, progress=NoProgress())
    found = examined_scan(folder, scan, OPTIONS, executor, NoProgress(), close=close)
    assert found.examination is not None
    assert "poses_drift" not in [finding.code for finding in found.examination.findings]
    assert found.loops is not None
    assert found.loops.is_applied
    assert found.scan is found.loops.scan
    (warning,) = found.warnings
    assert warning.startswith("The scan's positions drift")
