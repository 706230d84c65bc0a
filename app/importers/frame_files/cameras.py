"""One camera for a scan whose frames state one each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.errors import InvalidScanError
from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameCameraOptions:
    """How far the frames' own intrinsics may differ."""

    max_spread_ratio: float = limit(
        0.02,
        "How far a frame's focal length or principal point may be from the median, over the focal length.",
        chosen="By hand: the autofocus of phones moves it by up to 1 %; another lens by far more.",
    )


OPTIONS = FrameCameraOptions()


def common_intrinsics(intrinsics: Sequence[tuple[float, ...]], names: Sequence[str]) -> tuple[float, ...]:
    """Return the median (p,) of the frames' intrinsics `fx fy cx cy ...`.

    Raises `InvalidScanError` that names the first frame whose first four numbers are too far from it.
    """
    values = np.array(intrinsics, dtype=np.float64)
    median = np.median(values, axis=0)
    spread = np.abs(values[:, :4] - median[:4]).max(axis=1) / median[0]
    far = np.flatnonzero(~(spread <= OPTIONS.max_spread_ratio))
    if len(far):
        raise InvalidScanError(
            f"{names[far[0]]} has another focal length or principal point than most frames: send frames of one lens, "
            "without zoom."
        )
    return tuple(float(x) for x in median)
