"""Depth that is not that of its picture: what it is instead is named."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.engine.mapping.examination.scans import examined, write
from tests.scenes import View, scan_files

Depths = list[NDArray[np.float64]]


def with_depths(views: list[View], change: Callable[[Depths], Depths]) -> list[View]:
    depths = change([np.asarray(view.depth_m) for view in views])
    return [
        View(view.world_from_camera, view.rgb, depth_m) for view, depth_m in zip(views, depths, strict=True)
    ]


def each(change: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Callable[[Depths], Depths]:
    return lambda depths: [np.ascontiguousarray(change(depth_m)) for depth_m in depths]


def magnified(depth_m: NDArray[np.float64], wide: float, high: float) -> NDArray[np.float64]:
    height, width = depth_m.shape
    columns = (width - 1) / 2 * (1 - 1 / wide) + np.arange(width) / wide
    rows = (height - 1) / 2 * (1 - 1 / high) + np.arange(height) / high
    return depth_m[np.ix_(rows.round().astype(int), columns.round().astype(int))]


MISTAKES: dict[str, tuple[str, str, Callable[[Depths], Depths]]] = {
    "late": ("depth_of_other_frames", "late or early", lambda depths: [depths[0], *depths[:-1]]),
    "mirrored": ("depth_turned", "left for right", each(lambda depth_m: depth_m[:, ::-1])),
    "upside down": ("depth_turned", "upside down", each(lambda depth_m: depth_m[::-1, ::-1])),
    "narrow": ("depth_field", "field of view", each(lambda depth_m: magnified(depth_m, 1.15, 1.15))),
    "squeezed": ("depth_field", "aspect ratio", each(lambda depth_m: magnified(depth_m, 1.0, 4 / 3))),
    "disparity": ("depth_is_disparity", "convert them", each(lambda depth_m: 2.0 / depth_m)),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_depth_of_another_kind_is_named(name: str, views: list[View], tmp_path: Path) -> None:
    code, words, change = MISTAKES[name]
    found = examined(write(scan_files(with_depths(views, change)), tmp_path))
    assert ([finding.code for finding in found.wrong], found.remedy) == ([code], None)
    assert words in found.wrong[0].sentence


def test_depth_of_nowhere_has_no_cause(views: list[View], tmp_path: Path) -> None:
    rng = np.random.default_rng(0)

    def others(depths: Depths) -> Depths:
        return [np.asarray(np.roll(depth_m, rng.integers(60, 260), axis=1)) for depth_m in depths]

    found = examined(write(scan_files(with_depths(views, others)), tmp_path))
    assert [finding.code for finding in found.wrong] == ["depth_disagrees"]
    assert "%" in found.wrong[0].sentence


@pytest.mark.parametrize("shift", [(14, 0), (-11, 9)])
def test_depth_aside_is_moved_back(shift: tuple[int, int], views: list[View], tmp_path: Path) -> None:
    def aside(depth_m: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.roll(depth_m, (shift[1], shift[0]), axis=(0, 1)))

    found = examined(write(scan_files(with_depths(views, each(aside))), tmp_path))
    assert [finding.code for finding in found.wrong] == ["depth_shift"]
    assert found.remedy is not None
    assert found.remedy["depth_shift_px"] == pytest.approx([-shift[0], -shift[1]], abs=2)


def test_blank_depth_is_refused(views: list[View], tmp_path: Path) -> None:
    found = examined(write(scan_files(with_depths(views, each(lambda depth_m: 0.0 * depth_m))), tmp_path))
    assert ([finding.code for finding in found.wrong], found.remedy) == (["blank_depth"], None)
