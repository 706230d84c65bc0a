"""The figures of simulated navigation, by setting and by length of the path."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.stats import beta

from bench.simulation.walks import Outcome

# The thesis's mean position error.
THESIS_MEAN_M = 0.46
# The thesis's share of navigations that succeeded.
THESIS_SUCCESS_PERCENT = 90.6
COLUMNS = (
    "relocation", "frames / s", "light", "path m", "runs", "successful %", "95 % interval", "mean error m",
    "90 % error m", "located %", "wrong frames", "wrong by 3 sigmas, 1 m", "off route",
    "walked / route", "other ends", "ms a frame",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Setting:
    """How trips are walked: use of the map (`on`, `lost`, `off`), frames a second, light as a share of the day's.
    Without a map relocation is by monitoring cameras alone."""

    relocation: str
    fps: float
    light: float
    no_map: bool = False

    @property
    def label(self) -> str:
        """The setting in words."""
        source = ", no map" if self.no_map else ""
        return f"relocation {self.relocation}{source}, {self.fps:g} frames/s, light x{self.light:g}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """The figures of trips under one setting; `length_m` is None for those of all lengths."""

    setting: Setting
    length_m: float | None
    runs: int
    success_percent: float
    interval_percent: tuple[float, float]
    mean_error_m: float | None
    p90_error_m: float | None
    located_percent: float
    frames: int
    wrong_frames: int
    beyond_frames: int
    off_route_frames: int
    walked_share: float | None
    ends: dict[str, int]
    mean_ms: float

    def row(self) -> list[str]:
        """Return the cells under `COLUMNS`."""
        low, high = self.interval_percent
        others = {end: count for end, count in self.ends.items() if end != "arrived"}
        return [
            self.setting.relocation + (", no map" if self.setting.no_map else ""),
            f"{self.setting.fps:g}",
            f"x{self.setting.light:g}",
            "all" if self.length_m is None else f"{self.length_m:g}",
            str(self.runs),
            f"{self.success_percent:.1f}",
            f"{low:.0f}-{high:.0f}",
            _cell(self.mean_error_m),
            _cell(self.p90_error_m),
            f"{self.located_percent:.1f}",
            f"{self.wrong_frames} of {self.frames}",
            str(self.beyond_frames),
            str(self.off_route_frames),
            _cell(self.walked_share),
            ", ".join(f"{end} {count}" for end, count in others.items()) or "-",
            f"{self.mean_ms:.0f}",
        ]

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for JSON."""
        return asdict(self)


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def figures_of(setting: Setting, outcomes: Sequence[Outcome]) -> list[Figures]:
    """Return the figures of a setting's trips for each length, then for all."""
    lengths = sorted({one.length_m for one in outcomes})
    rows = [
        _figures(setting, length, [one for one in outcomes if one.length_m == length]) for length in lengths
    ]
    return [*rows, _figures(setting, None, outcomes)]


def _figures(setting: Setting, length_m: float | None, outcomes: Sequence[Outcome]) -> Figures:
    count, successes = len(outcomes), sum(one.is_success for one in outcomes)
    errors = [
        (one.mean_error_m, one.frames * one.told_percent) for one in outcomes if one.mean_error_m is not None
    ]
    weights = [weight for _, weight in errors]
    p90 = [one.p90_error_m for one in outcomes if one.p90_error_m is not None]
    walked = [one.walked_m / one.route_m for one in outcomes if one.is_success]
    frames = sum(one.frames for one in outcomes)
    return Figures(
        setting=setting,
        length_m=length_m,
        runs=count,
        success_percent=round(100.0 * successes / count, 1),
        interval_percent=interval_percent(successes, count),
        mean_error_m=round(float(np.average([e for e, _ in errors], weights=weights)), 3) if errors else None,
        p90_error_m=round(float(np.median(p90)), 3) if p90 else None,
        located_percent=round(sum(one.told_percent * one.frames for one in outcomes) / max(frames, 1), 1),
        frames=frames,
        wrong_frames=sum(one.wrong_frames for one in outcomes),
        beyond_frames=sum(one.beyond_frames for one in outcomes),
        off_route_frames=sum(one.off_route_frames for one in outcomes),
        walked_share=round(float(np.mean(walked)), 3) if walked else None,
        ends=dict(Counter(one.end for one in outcomes).most_common()),
        mean_ms=round(sum(one.mean_ms * one.frames for one in outcomes) / max(frames, 1), 1),
    )


def interval_percent(successes: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share of successes, percent (Clopper and Pearson, 1934)."""
    low = 0.0 if successes == 0 else float(beta.ppf(0.025, successes, count - successes + 1))
    high = 1.0 if successes == count else float(beta.ppf(0.975, successes + 1, count - successes))
    return round(100 * low, 1), round(100 * high, 1)


def floor_line(floor: int, outcomes: Sequence[Outcome]) -> str:
    """Return the sentence about what floors were stated on walks that begin on one floor."""
    frames = sum(one.frames for one in outcomes)
    placed = sum(round(one.told_percent * one.frames / 100.0) for one in outcomes)
    wrong = sum(one.wrong_floor_frames for one in outcomes)
    return (
        f"{len(outcomes)} walks begin on floor {floor}: {frames} frames, {placed} with a place, "
        f"{wrong} with a place on a wrong floor."
    )
