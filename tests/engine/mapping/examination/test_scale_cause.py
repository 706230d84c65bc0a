"""Depth or positions: which scale is named, and when it is beyond doubt."""

from __future__ import annotations

import pytest

from app.engine.mapping.examination.depth_ratio import DepthRatio
from app.engine.mapping.examination.scale_cause import Scales, judge_scale


def ratio(value: float, *, sigma: float = 0.01, depth_m: float = 2.0) -> DepthRatio:
    return DepthRatio(value, sigma, depth_m, 1000)


def scales(depth_scale: float = 1000.0, speed_m_s: float | None = 0.5) -> Scales:
    return Scales(depth_scale=depth_scale, position_scale=1.0, speed_m_s=speed_m_s)


@pytest.mark.parametrize(("value", "sigma"), [(1.0, 0.01), (0.93, 0.01), (1.3, 0.12)])
def test_a_ratio_near_one_or_poorly_known_is_right(value: float, sigma: float) -> None:
    assert judge_scale(ratio(value, sigma=sigma), scales()) is None


def test_a_ratio_a_little_off_is_doubtful() -> None:
    found = judge_scale(ratio(1.15), scales())
    assert found is not None
    assert (found.severity, dict(found.options)) == ("doubtful", {})


@pytest.mark.parametrize(
    ("value", "depth_scale", "depth_m", "options"),
    [
        (5.0, 5000.0, 0.4, {"depth_scale": 1000.0}),
        (0.2, 1000.0, 10.0, {"depth_scale": 5000.0}),
        (3.9, 1000.0, 0.5, {"depth_scale": 256.0}),
        (1000.0, 1000.0, 2.0, {"position_scale": 1000.0}),
        (3.28, 5000.0, 1.0, {"position_scale": 3.2808}),
    ],
)
def test_known_scales_are_named_beyond_doubt(
    value: float, depth_scale: float, depth_m: float, options: dict[str, float]
) -> None:
    found = judge_scale(ratio(value, depth_m=depth_m), scales(depth_scale))
    assert found is not None
    assert (dict(found.options), found.certain) == (options, True)


def test_a_factor_that_nobody_writes_names_both_and_repairs_nothing() -> None:
    found = judge_scale(ratio(1.7), scales())
    assert found is not None
    assert not found.certain
    assert "depth_scale" in found.sentence
    assert "position_scale" in found.sentence


def test_two_known_scales_within_the_error_are_no_certainty() -> None:
    found = judge_scale(ratio(0.22, sigma=0.12, depth_m=6.0), scales())
    assert found is not None
    assert not found.certain
