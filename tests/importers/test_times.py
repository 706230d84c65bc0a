"""Times of lists: their unit is found, and lists whose times were printed with too few digits are refused."""

from __future__ import annotations

import numpy as np
import pytest

from app.errors import InvalidScanError
from app.importers.rows.times import check_distinct, in_seconds

EPOCH_S = 1_305_031_100.0


@pytest.mark.parametrize("rate_hz", [1.0, 10.0, 30.0, 1000.0])
@pytest.mark.parametrize(
    ("unit", "per_s"), [("seconds", 1.0), ("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9)]
)
def test_times_since_1970_in_every_unit(unit: str, per_s: float, rate_hz: float) -> None:
    times_s = EPOCH_S + np.arange(20) / rate_hz
    found = in_seconds(times_s * per_s)
    assert found.unit == unit
    np.testing.assert_allclose(found.times_s, times_s, atol=1e-6)


@pytest.mark.parametrize(("unit", "per_s"), [("microseconds", 1e6), ("nanoseconds", 1e9)])
def test_times_since_the_start_of_a_device(unit: str, per_s: float) -> None:
    times_s = 200_000.0 + np.arange(20) / 30.0
    assert in_seconds(times_s * per_s).unit == unit
    assert in_seconds(np.arange(20.0)).unit == "seconds"


def test_one_time_alone_and_none() -> None:
    assert in_seconds(np.array([EPOCH_S * 1e6])).unit == "microseconds"
    assert in_seconds(np.array([np.nan])).unit == "seconds"
    assert in_seconds(np.array([1e40, 2e40])).unit == "seconds"


def test_lost_digits_are_named_with_file_and_time() -> None:
    good = EPOCH_S + np.arange(10) / 10
    check_distinct({"rgb.txt": good, "depth.txt": good, "groundtruth.txt": np.repeat(good, 2)})
    with pytest.raises(
        InvalidScanError, match=r"All rows of groundtruth\.txt have the time 1305030000: print more"
    ):
        check_distinct({"rgb.txt": good, "groundtruth.txt": np.full(10, 1305030000.0)})
    with pytest.raises(
        InvalidScanError, match=r"All rows of rgb\.txt, depth\.txt and groundtruth\.txt have the time"
    ):
        check_distinct(dict.fromkeys(("rgb.txt", "depth.txt", "groundtruth.txt"), np.full(3, 1.3e9)))
    with pytest.raises(
        InvalidScanError, match=r"groundtruth\.txt share their times, 50 of 100 have 130503110\d"
    ):
        check_distinct({"groundtruth.txt": np.repeat([1305031100.0, 1305031110.0], 50)})
