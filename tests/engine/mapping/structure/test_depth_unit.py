"""Depth images whose unit nobody stated and that can't have the usual one are refused before anything is matched."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.engine.mapping.structure.depth.unit import doubts_of_unit
from app.engine.mapping.structure.estimate import estimate_poses
from app.engine.mapping.structure.scale_options import KnownMarker
from app.engine.progress import NoProgress
from app.errors import CancelledBuildError, InvalidScanError
from app.importers.depth_figures import depth_figures
from app.importers.frames import Scan, ScanOptions
from app.importers.registry import open_scan
from app.importers.unposed.scan import UnposedScan
from tests.importers.scans import CAMERA_LINE, write_tum
from tests.rendered_maps import models
from tests.scenes import CAMERA, CAMERA_TEXT, DEPTH_SCALE, View, scan_files

NEARER, FARTHER = 5 * DEPTH_SCALE, DEPTH_SCALE / 8


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory, views: list[View]) -> Scan:
    folder = tmp_path_factory.mktemp("scan")
    for name, data in scan_files(views).items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(data)
    line = f"PINHOLE {CAMERA.width} {CAMERA.height} " + CAMERA_TEXT.replace(",", " ")
    (folder / "camera.txt").write_text(line)
    return open_scan(folder)


@pytest.fixture
def executor() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor(1) as threads:
        yield threads


def doubts(scan: Scan) -> tuple[str, ...]:
    measured = depth_figures(scan)
    assert measured is not None
    return doubts_of_unit(measured, scan.depth)


def read_by(scan: Scan, scale: float, is_stated: bool) -> Scan:
    return replace(scan, depth=replace(scan.depth, scale=scale, is_stated=is_stated))


def test_a_unit_is_stated_by_the_options_or_the_files(scan: Scan, tmp_path: Path) -> None:
    assert not scan.depth.is_stated
    folder = scan.frames[0].color.parents[1]
    assert open_scan(folder, options=ScanOptions(depth_scale=1000.0)).depth.is_stated
    stated = write_tum(tmp_path, camera=f"# depth_scale = 1000 per metre\n{CAMERA_LINE}")
    assert open_scan(stated).depth.is_stated


@pytest.mark.parametrize("is_stated", [True, False])
def test_depths_as_in_rooms_are_not_doubted(scan: Scan, is_stated: bool) -> None:
    assert doubts(read_by(scan, DEPTH_SCALE, is_stated)) == ()


@pytest.mark.parametrize(("scale", "than"), [(NEARER, "nearer than 0."), (FARTHER, "farther than ")])
def test_other_depths_are_doubted_and_refused_where_nobody_stated_the_unit(
    scan: Scan, scale: float, than: str
) -> None:
    (said,) = doubts(read_by(scan, scale, is_stated=True))
    assert said.startswith(f"Check depth_scale: half of what the depth images measure is {than}")
    with pytest.raises(InvalidScanError, match="unit of the depth images is not stated"):
        doubts(read_by(scan, scale, is_stated=False))


def test_blank_depth_images_have_no_unit(scan: Scan, monkeypatch: pytest.MonkeyPatch) -> None:
    blank = np.zeros((CAMERA.height, CAMERA.width), np.float32)
    monkeypatch.setattr(Scan, "depth_m", lambda *_: blank)
    assert doubts(read_by(scan, NEARER, is_stated=False)) == ()


class UntilMatched:
    """Progress of a build that is cancelled as soon as pictures are matched."""

    def report(self, stage: str, done: int, total: int) -> None:
        if stage not in ("measure_frames", "choose_frames"):
            raise CancelledBuildError(stage)


def test_a_build_refuses_them_first_unless_something_else_gives_the_scale(
    scan: Scan, executor: ThreadPoolExecutor
) -> None:
    unposed = UnposedScan(format="tum", listed=read_by(scan, NEARER, is_stated=False))
    with pytest.raises(InvalidScanError, match="Give depth_scale"):
        estimate_poses(unposed, None, models(), executor, UntilMatched())
    with pytest.raises(CancelledBuildError):
        estimate_poses(unposed, KnownMarker(0.2), models(), executor, UntilMatched())


def test_a_few_pictures_are_too_few(scan: Scan, executor: ThreadPoolExecutor) -> None:
    few = UnposedScan(format="tum", listed=replace(scan, frames=scan.frames[:4]))
    with pytest.raises(InvalidScanError, match="a map needs 8"):
        estimate_poses(few, None, models(), executor, NoProgress())
