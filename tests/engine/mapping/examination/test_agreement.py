"""How sure a scan's score is."""

from __future__ import annotations

import math

import numpy as np

from app.engine.mapping.examination.agreement import least_median


def test_the_lower_bound_of_a_median_is_one_sigma_of_its_rank_below() -> None:
    assert least_median(np.arange(13.0)) == 4.0
    assert least_median(np.arange(100.0)[::-1]) == 44.0
    assert least_median(np.array([3.0])) == 3.0
    assert math.isnan(least_median(np.zeros(0)))


def test_of_many_values_the_bound_is_near_the_median() -> None:
    values = np.random.default_rng(1).normal(1.0, 0.1, 4000)
    assert 0.99 < least_median(values) < np.median(values)
